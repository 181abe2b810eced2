import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends

from qjrl.geometry.pose import row_errors
from qjrl.robot import cable_lengths, forward_kinematics
from qjrl.simulation import SettleConfig, settle
from qjrl.solvers import LeastSquaresConfig
from qjrl.studies.accuracy.feedback import MeasurementNoise, measure_and_correct, measured_pose, missing_pose
from qjrl.studies.accuracy.held_out import reachable_targets

ARM = arm_named("qj_22")
SOLVER = LeastSquaresConfig(num_candidates=64, batch_size=16)
EXACT = MeasurementNoise(0.0, 0.0)


@pytest.fixture(scope="module")
def poses():
    return over_rows(forward_kinematics, ARM, random_bends(ARM, 8, seed=3))


def test_a_model_that_agrees_with_the_measurement_is_asked_for_the_target(poses):
    wanted = jax.vmap(missing_pose)(jnp.asarray(poses[:4]), jnp.asarray(poses[:4]), jnp.asarray(poses[4:]))
    np.testing.assert_allclose(wanted, poses[4:], atol=1e-12)


def test_an_arm_at_its_target_is_left_there(poses):
    wanted = jax.vmap(missing_pose)(jnp.asarray(poses[:4]), jnp.asarray(poses[4:]), jnp.asarray(poses[4:]))
    np.testing.assert_allclose(wanted, poses[:4], atol=1e-12)


def test_the_noise_of_a_measurement_has_the_stated_size(poses):
    noise, keys = MeasurementNoise(1e-3, 1e-2), jax.random.split(jax.random.key(0), 4000)
    seen = jax.vmap(lambda key: measured_pose(jnp.asarray(poses[0]), noise, key))(keys)
    shift, turn = row_errors(seen, np.repeat(poses[:1], 4000, axis=0))
    assert np.sqrt(np.mean(shift**2) / 3) == pytest.approx(1e-3, rel=0.05)
    assert np.sqrt(np.mean(turn**2) / 3) == pytest.approx(1e-2, rel=0.05)


def test_measurements_bring_the_nominal_controller_to_targets_the_arm_can_reach():
    elsewhere = over_rows(cable_lengths, ARM, random_bends(ARM, 6, seed=8, share=0.7))
    targets = settle(ARM, elsewhere).pose
    lengths = elsewhere + 0.002 * np.sin(np.arange(elsewhere.size)).reshape(elsewhere.shape)
    found = measure_and_correct(ARM, None, SettleConfig(), SOLVER, targets, lengths, 3, EXACT, 0)
    medians = np.median(found.position_error, axis=1)
    assert medians[0] > 5e-3 and medians[1] < 0.01 * medians[0]
    assert medians[2] < 2e-6  # a tenth of the solver's tolerance is where it stops


def test_held_out_targets_keep_their_distance_from_the_training_rows():
    trained = over_rows(forward_kinematics, ARM, random_bends(ARM, 200, seed=1))
    targets = reachable_targets(ARM, SettleConfig(), trained, 20, 0.005, seed=0)
    gaps = np.linalg.norm(targets[:, None, :3] - trained[None, :, :3], axis=-1).min(axis=1)
    assert targets.shape == (20, 9) and gaps.min() >= 0.005
