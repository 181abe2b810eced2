import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named
from settled import ARM, settled_rows

from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, build
from qjrl.learning.fitting import FitConfig, FittedNetwork
from qjrl.learning.networks import NetworkConfig
from qjrl.robot import bends_from_cables, cable_strokes
from qjrl.robot.forward_model import (
    ForwardModel,
    ForwardModelConfig,
    load_forward_model,
    make_network,
    model_inputs,
    model_pose,
    pose_function,
    save_forward_model,
)
from qjrl.robot.model_coordinates import model_targets
from qjrl.robot.model_errors import pose_errors
from qjrl.robot.model_fitting import fit_forward_model, split_rows
from qjrl.robot.network_fitting import evaluation

FORMS = ("paper", "corrected_from_lengths", "corrected")
CORRECTED = ForwardModelConfig(
    "corrected",
    NetworkConfig(width=32, num_blocks=1, num_frequencies=1, zero_output=True),
    FitConfig(epochs=40, batch_size=16, evaluate_every=20),
    held_out=0.25,
)
FROM_LENGTHS = dataclasses.replace(CORRECTED, form="corrected_from_lengths")
PAPER = dataclasses.replace(CORRECTED, form="paper", network=NetworkConfig(16, 1, 2, zero_output=False))


def settled():
    rows = settled_rows()
    return {name: column[rows["converged"]] for name, column in rows.items()}


def untrained(config):
    """A model as it is before the first step of a fit, its outputs as they come from the network."""
    size = 9 if config.form == "paper" else ARM.num_cables
    parameters = make_network(ARM, config).init(jax.random.key(0), jnp.zeros((1, ARM.num_cables), jnp.float32))[
        "params"
    ]
    return ForwardModel(FittedNetwork(parameters, jnp.zeros(size, jnp.float32), jnp.ones(size, jnp.float32)), config)


def poses_of(model, lengths):
    return np.asarray(jax.jit(jax.vmap(pose_function(ARM, model)))(jnp.asarray(lengths)))


def rows_with_some_unsettled():
    """Rows 5 to 8 never came to rest, and hold nothing of use."""
    data = {name: column.copy() for name, column in settled_rows().items()}
    data["converged"][5:9] = False
    data["pose"][5:9] = np.nan
    data["bends"][5:9] = np.nan
    return data


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    return fit_forward_model(ARM, CORRECTED, rows_with_some_unsettled(), 0, tmp_path_factory.mktemp("fit"))


@pytest.mark.parametrize("config", [FROM_LENGTHS, CORRECTED], ids=FORMS[1:])
def test_an_untrained_correction_is_exactly_the_nominal_closed_form(config):
    lengths = settled()["cable_lengths"]
    np.testing.assert_array_equal(poses_of(untrained(config), lengths), poses_of(None, lengths))


def test_the_true_corrections_give_the_settled_poses():
    """Inputs, targets and pose agree: the links are rigid, so eight bends say all of the pose."""
    data = settled()
    answers = model_targets(ARM, "corrected", data)
    poses = jax.vmap(lambda row, answer: model_pose(ARM, "corrected", row, answer))(
        jnp.asarray(data["cable_lengths"]), answers
    )
    np.testing.assert_allclose(poses, data["pose"], atol=2e-6)
    assert np.linalg.norm(np.asarray(poses)[:, :3] - data["pose"][:, :3], axis=1).max() < 1e-6


def test_the_papers_form_learns_the_pose_itself():
    data = settled()
    answers = model_targets(ARM, "paper", data)
    np.testing.assert_array_equal(answers, data["pose"])
    np.testing.assert_array_equal(model_pose(ARM, "paper", data["cable_lengths"][0], answers[0]), data["pose"][0])


@pytest.mark.parametrize("form", FORMS)
def test_inputs_are_scaled_to_one(form):
    inputs = np.array([model_inputs(ARM, form, jnp.asarray(row)) for row in settled()["cable_lengths"]])
    assert inputs.shape[1] == ARM.num_cables and 0.5 < np.abs(inputs).max() <= 1 + 1e-9
    at_stroke = np.asarray(model_inputs(ARM, "paper", cable_strokes(ARM)))
    np.testing.assert_allclose(at_stroke, 1.0)
    expected = np.asarray(bends_from_cables(ARM, settled()["cable_lengths"][0])) / np.sin(float(ARM.bend_limit) / 2)
    np.testing.assert_allclose(
        np.asarray(model_inputs(ARM, "corrected", settled()["cable_lengths"][0])), expected.ravel()
    )


def test_a_fit_on_a_few_rows_improves_on_the_nominal_closed_form(fitted):
    _, metrics = fitted
    assert metrics["held_out"]["median_mm"] < 0.7 * metrics["nominal"]["median_mm"]
    assert metrics["held_out"]["median_deg"] < metrics["nominal"]["median_deg"]
    rows = metrics["rows"]
    assert rows["fitted"] + rows["held_out"] + rows["unsettled"] == len(settled_rows()["seed"])


def test_the_metrics_are_the_returned_models_errors_on_the_held_out_rows(fitted):
    model, metrics = fitted
    data = rows_with_some_unsettled()
    data = {name: column[data["converged"]] for name, column in data.items()}
    _, held_out = split_rows(len(data["seed"]), CORRECTED.held_out, 0)
    again = pose_errors(poses_of(model, data["cable_lengths"][held_out]), data["pose"][held_out])
    assert again.keys() <= metrics["held_out"].keys()
    for name, value in again.items():
        assert value == pytest.approx(metrics["held_out"][name], rel=1e-3)
    nominal = pose_errors(poses_of(None, data["cable_lengths"][held_out]), data["pose"][held_out])
    assert nominal == pytest.approx(metrics["nominal"])


def test_rows_that_never_settled_are_in_no_fit(fitted):
    model, metrics = fitted
    assert metrics["rows"]["unsettled"] == int(np.sum(~rows_with_some_unsettled()["converged"]))
    assert np.isfinite(metrics["held_out"]["p99_mm"]) and np.isfinite(poses_of(model, settled()["cable_lengths"])).all()


def test_errors_are_in_millimetres_and_degrees_by_hand():
    true = np.tile([0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], (3, 1))
    turned = true.copy()
    turned[:, 0] = [0.001, 0.002, 0.004]
    c, s = np.cos(0.01), np.sin(0.01)
    turned[:, 3:] = [c, s, 0.0, -s, c, 0.0]
    errors = pose_errors(turned, true)
    assert errors["median_mm"] == pytest.approx(2.0) and errors["p90_mm"] == pytest.approx(3.6)
    assert errors["median_deg"] == errors["p99_deg"] == pytest.approx(np.degrees(0.01))


def test_the_evaluation_of_perfect_answers_is_zero():
    data = settled()
    answers = model_targets(ARM, "corrected", data)
    errors = evaluation(ARM, "corrected", data)(lambda inputs: answers)
    assert errors["p99_mm"] < 1e-3 and errors["p99_deg"] < 1e-3


@pytest.mark.parametrize("config", [PAPER, FROM_LENGTHS, CORRECTED], ids=FORMS)
def test_a_saved_model_comes_back_bit_for_bit(tmp_path, config):
    model, lengths = untrained(config), settled()["cable_lengths"][:8]
    save_forward_model(tmp_path / "model", ARM, model)
    back = load_forward_model(tmp_path / "model", ARM)
    assert back.config == config
    np.testing.assert_array_equal(poses_of(back, lengths), poses_of(model, lengths))


def test_the_model_of_another_robot_is_refused(tmp_path):
    save_forward_model(tmp_path / "model", ARM, untrained(CORRECTED))
    with pytest.raises(ArtifactError, match=r"model\.json: belongs to another robot than qj_huang_4332"):
        load_forward_model(tmp_path / "model", arm_named("qj_huang_4332"))


def test_a_missing_or_truncated_model_is_one_line(tmp_path):
    with pytest.raises(ArtifactError, match="does not exist"):
        load_forward_model(tmp_path / "model", ARM)
    save_forward_model(tmp_path / "model", ARM, untrained(CORRECTED))
    whole = (tmp_path / "model.npz").read_bytes()
    (tmp_path / "model.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ArtifactError, match="truncated"):
        load_forward_model(tmp_path / "model", ARM)


def test_the_split_is_a_function_of_its_arguments_and_a_partition():
    fit, held_out = split_rows(50, 0.1, 3)
    assert len(held_out) == 5 and sorted([*fit, *held_out]) == list(range(50))
    again = split_rows(50, 0.1, 3)
    assert np.array_equal(fit, again[0]) and np.array_equal(held_out, again[1])
    assert not np.array_equal(held_out, split_rows(50, 0.1, 4)[1])
    assert [len(part) for part in split_rows(2, 0.01, 0)] == [1, 1]


def test_too_few_settled_rows_are_refused():
    with pytest.raises(ValueError, match="data set: got 1 settled rows, expected at least 2"):
        split_rows(1, 0.1, 0)


def test_an_unknown_form_is_one_line():
    with pytest.raises(ConfigError, match=r"^forward_model\.form: got 'corect'"):
        build(ForwardModelConfig, {"form": "corect"}, "forward_model")


def test_a_model_has_gradients_at_home(fitted):
    jacobian = jax.jit(jax.jacobian(pose_function(ARM, fitted[0])))(jnp.zeros(ARM.num_cables))
    assert np.isfinite(jacobian).all() and np.abs(jacobian).max() > 0.1
