"""A kind of forward model that is registered here goes through everything that models go through: no stage knows it."""

import copy
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from ridge_model import RIDGE, RidgeConfig, registered
from settled import ARM, settled_rows

from qjrl import artifacts, pipeline
from qjrl.artifacts import ArtifactError
from qjrl.cli import defaults
from qjrl.config import ConfigError, as_mapping, conf_folder, identity_of, read_yaml
from qjrl.deployment.functions import forward_function
from qjrl.learning.fitting import FitConfig
from qjrl.learning.networks import NetworkConfig
from qjrl.robot import robot_hash
from qjrl.robot.forward_model import (
    ForwardModelConfig,
    load_forward_model,
    load_pose_function,
    pose_function,
    save_forward_model,
)
from qjrl.robot.model_fitting import errors_of, fit_forward_model
from qjrl.robot.model_kinds import MODEL_KINDS
from qjrl.robot.pose_model import ClosedForm, model_poses
from qjrl.solvers import LeastSquaresConfig, solve_least_squares

SMALL = ForwardModelConfig(network=NetworkConfig(16, 1), fit=FitConfig(epochs=4, batch_size=16, evaluate_every=4))


@pytest.fixture(scope="module", autouse=True)
def _registered():
    with registered():
        yield


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    return fit_forward_model(ARM, RidgeConfig(), settled_rows(), 0, tmp_path_factory.mktemp("ridge"))


def tree_of(**forward_model):
    robot = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    return {"name": "tiny", "seed": 0, "robot": robot, "forward_model": forward_model}


def configs_of(stages, **groups):
    forward_model = groups.pop("forward_model", {})
    return pipeline.build_configs(tree_of(**forward_model) | groups, stages)


def test_its_configuration_is_read_by_its_name_and_the_network_is_meant_without_one():
    assert configs_of(["forward_model"])["forward_model"].forward_model == ForwardModelConfig()
    built = configs_of(["forward_model"], forward_model={"kind": "ridge", "strength": 2})
    assert built["forward_model"].forward_model == RidgeConfig(strength=2.0)
    named = configs_of(["forward_model"], forward_model={"kind": "network", "form": "paper"})
    assert named["forward_model"].forward_model == ForwardModelConfig("paper")


@pytest.mark.parametrize(
    ("forward_model", "line"),
    [
        (
            {"kind": "rigde"},
            r"forward_model\.kind: got 'rigde', allowed: one of network, gaussian_process, grey, grey_gaussian_process, ridge",
        ),
        ({"kind": "ridge", "strenght": 1}, r"forward_model\.strenght: got 1, .*did you mean 'strength'"),
        ({"strength": 1}, r"forward_model\.strength: got 1, allowed with kind=ridge"),
        ({"kind": "ridge", "form": "paper"}, r"forward_model\.form: got 'paper', allowed with kind=network"),
        ({"network": {"widht": 1}}, r"forward_model\.network\.widht: got 1, .*did you mean 'width'"),
    ],
    ids=str,
)
def test_what_is_wrong_in_it_is_one_line(forward_model, line):
    with pytest.raises(ConfigError, match=f"^{line}"):
        configs_of(["forward_model"], forward_model=forward_model)


def test_every_kind_has_what_is_asked_of_all_and_its_key_is_what_its_configuration_says():
    for name, kind in MODEL_KINDS.items():
        config = kind.config()
        assert config.kind == name and 0.0 < config.held_out <= 0.5
    assert "kind" not in identity_of(ForwardModelConfig())  # runs from before it was said stay valid
    assert identity_of(RidgeConfig())["kind"] == "ridge"


def test_its_fit_improves_on_the_closed_form_and_is_measured_like_any_other(fitted):
    model, metrics = fitted
    assert metrics["held_out"]["median_mm"] < metrics["nominal"]["median_mm"]
    assert metrics["kind"] == "ridge" and metrics["strength"] == 1e-3
    assert metrics["size"] == 5 * 4 == model.slopes.size
    assert metrics["rows"].keys() == {"fitted", "held_out", "unsettled"}


def test_a_saved_one_comes_back_bit_for_bit_and_names_what_it_lacks(tmp_path, fitted):
    save_forward_model(tmp_path / "model", ARM, fitted[0])
    back, lengths = load_forward_model(tmp_path / "model", ARM), settled_rows()["cable_lengths"]
    assert back.config == RidgeConfig()
    poses = model_poses(load_pose_function(tmp_path / "model", ARM), lengths)
    np.testing.assert_array_equal(poses, model_poses(pose_function(ARM, fitted[0]), lengths))
    artifacts.write_arrays(tmp_path / "model.npz", {"other": np.zeros(2)})
    with pytest.raises(ArtifactError, match=r"model\.npz: is not the parameters of a ridge \(slopes is missing\)"):
        load_forward_model(tmp_path / "model", ARM)


def test_a_file_that_names_no_kind_holds_a_network_and_one_of_an_unknown_kind_is_refused(tmp_path):
    model, _ = fit_forward_model(ARM, SMALL, settled_rows(), 0, tmp_path / "fit")
    save_forward_model(tmp_path / "model", ARM, model)
    description, lengths = json.loads((tmp_path / "model.json").read_text()), settled_rows()["cable_lengths"]
    older = copy.deepcopy(description)
    assert older["config"].pop("kind") == "network"
    artifacts.write_json(tmp_path / "model.json", older)
    back = load_forward_model(tmp_path / "model", ARM)
    assert back.config == SMALL
    poses = [model_poses(pose_function(ARM, one), lengths) for one in (back, model)]
    np.testing.assert_array_equal(poses[0], poses[1])
    description["config"]["kind"] = "octopus"
    artifacts.write_json(tmp_path / "model.json", description)
    with pytest.raises(
        ArtifactError,
        match=r"model\.json: config\.kind: got 'octopus', allowed: one of network, gaussian_process, grey, grey_gaussian_process, ridge",
    ):
        load_forward_model(tmp_path / "model", ARM)


def test_least_squares_inverts_it(fitted):
    model = pose_function(ARM, fitted[0])
    targets = model_poses(model, settled_rows()["cable_lengths"][:8])
    found = solve_least_squares(ARM, targets, config=LeastSquaresConfig(num_candidates=128, batch_size=16), model=model)
    assert np.all(found.converged)
    np.testing.assert_allclose(model_poses(model, found.cable_lengths)[:, :3], targets[:, :3], atol=1e-5)
    nominal = model_poses(ClosedForm(ARM), found.cable_lengths)
    assert np.abs(nominal - targets).max() > 1e-4  # it is not the closed form that was inverted


def test_the_stages_fit_it_and_invert_it(tmp_path, fitted):
    artifacts.append_shard(tmp_path / "dataset", settled_rows(), robot_hash(ARM))
    artifacts.mark_done(tmp_path / "dataset", robot_hash=robot_hash(ARM))
    few = {"least_squares": {"num_candidates": 128, "batch_size": 16}, "num_held_out": 2, "num_bank": 2}
    groups = {"ik": few, "simulation": {"batch_size": 32}}
    configs = configs_of(["forward_model", "ik"], forward_model={"kind": "ridge"}, **groups)
    pipeline.run(["forward_model", "ik"], configs, tmp_path)
    metrics = artifacts.load(tmp_path / "forward_model" / "metrics.json")
    assert metrics["held_out"] == pytest.approx(fitted[1]["held_out"])
    loaded = load_forward_model(tmp_path / "forward_model" / "model", ARM)
    np.testing.assert_allclose(loaded.slopes, fitted[0].slopes)
    answers = artifacts.load(tmp_path / "ik" / "held_out.npz")
    assert answers["converged"].all()
    errors = model_poses(pose_function(ARM, loaded), answers["learned_lengths"]) - answers["target"]
    np.testing.assert_allclose(np.linalg.norm(errors[:, :3], axis=1), answers["predicted_position_error"], atol=1e-9)


def test_its_exported_function_is_in_the_precision_of_the_export(fitted):
    deployed = forward_function(ARM, fitted[0], "float32")
    lengths = jnp.zeros(ARM.num_cables, jnp.float32)
    assert deployed.function(lengths)["pose"].dtype == jnp.float32


def test_the_command_prints_the_settings_of_the_kind_that_is_asked_for():
    for words, expected in (((), ForwardModelConfig()), (("forward_model.kind=ridge",), RidgeConfig())):
        defaults.register_for(words, ["--cfg"])
        with initialize_config_dir(version_base=None, config_dir=str(conf_folder())):
            tree = OmegaConf.to_container(compose("config", list(words)))
        assert isinstance(tree, dict) and tree["forward_model"] == as_mapping(expected)


def test_errors_are_those_of_the_poses(fitted):
    data = settled_rows()
    assert errors_of(ARM, fitted[0], data)["p99_mm"] < errors_of(ARM, None, data)["p99_mm"]
    assert len(jax.tree.leaves(pose_function(ARM, fitted[0]))) == len(jax.tree.leaves(ARM)) + 1
    assert RIDGE.size(fitted[0]) == 20
