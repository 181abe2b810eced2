import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from settled import ARM, settled_rows

from qjrl import artifacts, pipeline
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, conf_folder, read_yaml, shipped
from qjrl.geometry.pose import row_errors
from qjrl.robot import in_precision, robot_hash
from qjrl.robot.forward_model import load_forward_model, load_pose_function, pose_function, save_forward_model
from qjrl.robot.gaussian_process_model import (
    GaussianProcessModelConfig,
    answer_and_variance,
    corrected_pose,
    measured_uncertainty,
    pose_and_sigma,
)
from qjrl.robot.model_fitting import fit_forward_model
from qjrl.robot.pose_model import model_poses


def fit(tmp_path, data=None, **settings):
    data = settled_rows() if data is None else data
    return fit_forward_model(ARM, GaussianProcessModelConfig(**settings), data, 0, tmp_path)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    return fit(tmp_path_factory.mktemp("process"))


@pytest.fixture(scope="module")
def few_own(tmp_path_factory):
    settings = {"length_scales": "own", "kernel": "rational_quadratic", "max_rows": 25}
    return fit(tmp_path_factory.mktemp("own"), **settings)


@pytest.fixture(scope="module")
def twists(tmp_path_factory):
    return fit(tmp_path_factory.mktemp("twists"), coding="body_twist")


def assert_improves(metrics, share):
    for name in ("median_mm", "median_deg"):
        assert metrics["held_out"][name] < share * metrics["nominal"][name]
    assert metrics["uncertainty"].keys() == {"position", "orientation", "outputs"}


def test_a_corrected_configuration_improves_tenfold_on_the_closed_form(fitted):
    model, metrics = fitted
    assert_improves(metrics, 0.1)  # the physics turns the joints
    assert model.process.inputs.shape == (metrics["rows"]["fitted"], 4)


def test_a_corrected_pose_improves_twofold_in_every_coding(tmp_path, twists):
    assert_improves(twists[1], 0.5)
    for coding, inputs in (("split", "configuration_and_tip"), ("spatial_twist", "configuration")):
        model, metrics = fit(tmp_path, coding=coding, inputs=inputs)
        assert_improves(metrics, 0.5)
        assert model.process.inputs.shape[1] == (4 if inputs == "configuration" else 7)


def test_rows_beyond_the_most_are_left_out_and_the_metrics_say_so(few_own, fitted):
    model, metrics = few_own
    assert model.process.inputs.shape[0] == 25
    assert metrics["rows"]["fitted"] == 25 and metrics["rows"]["beyond_max_rows"] == fitted[1]["rows"]["fitted"] - 25
    assert metrics["rows"].keys() == {"fitted", "held_out", "unsettled", "beyond_max_rows"}
    assert fitted[1]["rows"]["beyond_max_rows"] == 0
    assert len(metrics["process"]["noise"]) == 4  # one a number of the configuration


def test_the_deviations_are_those_of_poses_drawn_from_the_answers(twists):
    model, _ = twists
    lengths = jnp.asarray(settled_rows()["cable_lengths"][40])
    estimated = pose_and_sigma(ARM, model)
    answer, variance = jax.jit(answer_and_variance)(estimated.mean, lengths)
    drawn = answer + jnp.sqrt(variance) * np.random.default_rng(0).normal(size=(4_000, 6))
    poses = jax.jit(jax.vmap(lambda one: corrected_pose(ARM, "body_twist", lengths, one)))(drawn)
    estimate = jax.jit(estimated)(lengths)
    spread = [np.sqrt(np.mean(error**2) / 3) for error in row_errors(poses, np.tile(estimate.pose, (len(poses), 1)))]
    np.testing.assert_allclose([estimate.position_sigma, estimate.orientation_sigma], spread, rtol=0.03)
    np.testing.assert_allclose(estimate.pose, model_poses(pose_function(ARM, model), lengths[None])[0], atol=1e-12)


def test_coverage_falls_where_the_process_is_too_sure(fitted):
    model, metrics = fitted
    unsure = model.process.replace(
        hyperparameters=model.process.hyperparameters.replace(noise=model.process.hyperparameters.noise + 10.0)
    )
    wide = measured_uncertainty(ARM, model.replace(process=unsure), settled_rows())
    assert all(report["coverage_50_percent"] == 100.0 for report in wide.values())
    found = metrics["uncertainty"]
    assert found["position"]["median_sigma_mm"] > 0 and found["orientation"]["median_sigma_deg"] > 0
    for report in found.values():
        assert (
            0 <= report["coverage_50_percent"] <= report["coverage_90_percent"] <= report["coverage_95_percent"] <= 100
        )


def test_a_saved_one_comes_back_bit_for_bit_with_its_deviations(tmp_path, few_own):
    model, _ = few_own
    save_forward_model(tmp_path / "model", ARM, model)
    back = load_forward_model(tmp_path / "model", ARM)
    assert back.config == model.config
    jax.tree.map(np.testing.assert_array_equal, back, model)
    held = artifacts.load(tmp_path / "model.npz")
    assert not any("cholesky" in name for name in held)
    artifacts.write_arrays(tmp_path / "model.npz", {name: one for name, one in held.items() if name != "weights"})
    with pytest.raises(ArtifactError, match=r"is not the parameters of a gaussian_process \(weights is missing\)"):
        load_forward_model(tmp_path / "model", ARM)


def test_it_answers_in_the_precision_of_the_lengths_and_computes_in_float64(fitted):
    lengths = settled_rows()["cable_lengths"][:8]
    narrow = model_poses(pose_function(in_precision(ARM, "float32"), fitted[0]), lengths.astype(np.float32))
    assert narrow.dtype == np.float32
    np.testing.assert_allclose(narrow, model_poses(pose_function(ARM, fitted[0]), lengths), atol=3e-6)


def test_the_stages_fit_it_and_invert_it(tmp_path):
    artifacts.append_shard(tmp_path / "dataset", settled_rows(), robot_hash(ARM))
    artifacts.mark_done(tmp_path / "dataset", robot_hash=robot_hash(ARM))
    tree = {
        "name": "tiny",
        "seed": 0,
        "robot": read_yaml(conf_folder() / "robot" / "qj_22.yaml"),
        "forward_model": read_yaml(conf_folder() / "forward_model" / "gaussian_process.yaml"),
        "ik": {"least_squares": {"num_candidates": 128, "batch_size": 16}, "num_held_out": 2, "num_bank": 2},
        "simulation": {"batch_size": 32},
    }
    stages = ["forward_model", "ik"]
    pipeline.run(stages, pipeline.build_configs(tree, stages), tmp_path)
    metrics = json.loads((tmp_path / "forward_model" / "metrics.json").read_text())
    assert metrics["kind"] == "gaussian_process" and metrics["process"]["noise"][0] > 0
    answers = artifacts.load(tmp_path / "ik" / "held_out.npz")
    assert answers["converged"].all()
    loaded = load_pose_function(tmp_path / "forward_model" / "model", ARM)
    errors = model_poses(loaded, answers["learned_lengths"]) - answers["target"]
    np.testing.assert_allclose(np.linalg.norm(errors[:, :3], axis=1), answers["predicted_position_error"], atol=1e-9)


def test_fewer_than_ten_rows_are_one_line(tmp_path):
    few = {name: column[:10] for name, column in settled_rows().items()}
    with pytest.raises(ConfigError, match=r"^Gaussian process: got 9 rows, allowed: at least 10$"):
        fit(tmp_path, few)


def test_the_shipped_choice_is_the_default():
    assert shipped(GaussianProcessModelConfig, "forward_model/gaussian_process") == GaussianProcessModelConfig()
    with pytest.raises(ConfigError, match=r"max_rows: got 5001, allowed: .*5,?000"):
        GaussianProcessModelConfig(max_rows=5001)
