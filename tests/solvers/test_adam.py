import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends

from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot import bends_from_cables, cable_lengths, forward_kinematics
from qjrl.robot.forward_model import pose_function
from qjrl.solvers import AdamConfig, Status, solve_adam

ARM = arm_named("qj_22")
CONFIG = AdamConfig(iterations=100, decay=True, num_restarts=3, num_candidates=1024, num_retries=1, batch_size=16)
QUICK = dataclasses.replace(CONFIG, iterations=3, num_restarts=2, num_candidates=16, num_retries=0, batch_size=8)


def reachable(count, seed=0):
    return over_rows(forward_kinematics, ARM, random_bends(ARM, count, seed))


def biased_model(lengths):
    """Any other model of the arm: the closed form with every cable 2 mm longer than it thinks."""
    return pose_function(ARM, None)(lengths + 0.002)


def assert_consistent(result, targets, model):
    """What is reported is what the model says of the answers."""
    poses = jax.jit(jax.vmap(model))(result.cable_lengths)
    np.testing.assert_allclose(result.position_error, jax.vmap(position_error)(poses, targets), atol=1e-12)
    np.testing.assert_allclose(result.orientation_error, jax.vmap(orientation_error)(poses, targets), atol=1e-9)
    np.testing.assert_allclose(result.bends, over_rows(bends_from_cables, ARM, result.cable_lengths), atol=1e-12)
    assert np.linalg.norm(result.bends, axis=-1).max() <= np.sin(float(ARM.bend_limit) / 2) + 1e-9
    assert np.array_equal(result.converged, np.asarray(result.status) == Status.CONVERGED)


@pytest.fixture(scope="module")
def solved():
    targets = reachable(16)
    return targets, solve_adam(ARM, targets, config=CONFIG)


def test_reachable_targets_are_reached_to_a_millimetre(solved):
    _, result = solved
    good = (np.asarray(result.position_error) < 1e-3) & (np.asarray(result.orientation_error) < np.radians(0.5))
    assert good.mean() >= 0.9
    np.testing.assert_array_equal(result.converged, good)


def test_the_errors_reported_are_those_of_the_answers_and_the_limits_hold(solved):
    targets, result = solved
    assert_consistent(result, jnp.asarray(targets), pose_function(ARM, None))


def test_every_attempt_counts_its_steps(solved):
    _, result = solved
    once = CONFIG.iterations * CONFIG.num_restarts
    assert set(np.asarray(result.steps).tolist()) <= {once, 2 * once}
    assert np.all(np.asarray(result.steps)[~np.asarray(result.converged)] == 2 * once)


def test_the_model_that_is_asked_is_the_model_that_is_inverted():
    targets = reachable(8)
    result = solve_adam(ARM, targets, biased_model, CONFIG)
    assert_consistent(result, jnp.asarray(targets), biased_model)
    assert np.mean(result.converged) >= 0.7
    # The answers are 2 mm shorter than those of the closed form.
    exact = over_rows(cable_lengths, ARM, random_bends(ARM, 8)) - 0.002
    found = np.asarray(result.cable_lengths)[np.asarray(result.converged)]
    assert np.abs(found - exact[np.asarray(result.converged)]).max() < 1.5e-3


def test_an_unreachable_target_comes_back_not_converged_and_finite():
    targets = reachable(3).copy()
    targets[0, :3] = [0.0, 0.0, 5.0]  # beyond the arm's length
    targets[1, 3:] = [-1.0, 0.0, 0.0, 0.0, 1.0, 0.0]  # the right place, upside down
    result = solve_adam(ARM, targets, config=QUICK)
    assert not np.any(np.asarray(result.converged)[:2])
    assert np.all(np.asarray(result.status)[:2] == Status.ITERATION_LIMIT)
    for field in dataclasses.fields(result):
        assert np.isfinite(np.asarray(getattr(result, field.name), float)).all(), field.name
    assert_consistent(result, jnp.asarray(targets), pose_function(ARM, None))


def test_an_answer_is_never_worse_than_home():
    """Few wild steps from a bad start end anywhere: then home is the answer, and its errors are home's."""
    config = dataclasses.replace(QUICK, learning_rate=1.0, num_candidates=2)
    home = np.asarray(forward_kinematics(ARM, jnp.zeros((2, 2))))[None]
    result = solve_adam(ARM, home, config=config)
    assert_consistent(result, jnp.asarray(home), pose_function(ARM, None))
    np.testing.assert_array_equal(result.cable_lengths, np.zeros((1, ARM.num_cables)))
    assert result.converged[0] and result.position_error[0] < 1e-12


def test_rows_do_not_depend_on_their_neighbours_or_on_padding():
    targets = reachable(8, seed=2)
    together = solve_adam(ARM, targets, config=QUICK).cable_lengths
    np.testing.assert_array_equal(solve_adam(ARM, targets[3:6], config=QUICK).cable_lengths, together[3:6])
    config = dataclasses.replace(QUICK, batch_size=3)
    np.testing.assert_allclose(solve_adam(ARM, targets, config=config).cable_lengths, together, atol=1e-9)


def test_the_same_seed_gives_the_same_answers_and_progress_counts_every_target_once():
    targets, counted = reachable(11), []
    first = solve_adam(ARM, targets, config=QUICK, seed=1, advance=counted.append)
    again = solve_adam(ARM, targets, config=QUICK, seed=1)
    assert sum(counted) == 11
    np.testing.assert_array_equal(first.cable_lengths, again.cable_lengths)
    assert not np.array_equal(solve_adam(ARM, targets, config=QUICK, seed=2).cable_lengths, first.cable_lengths)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda targets: targets[0], r"targets: got shape \(9,\), allowed: \(n, 9\)"),
        (lambda targets: targets[:, :6], r"targets: got shape \(4, 6\)"),
        (
            lambda targets: np.where(np.arange(4)[:, None] == 2, np.nan, targets),
            "targets: got non-finite values in row 2",
        ),
        (
            lambda targets: np.where(np.arange(4)[:, None] == 1, np.inf, targets),
            "targets: got non-finite values in row 1",
        ),
        (lambda targets: targets * np.where(np.arange(9) == 3, 1.1, 1.0), "row 0 is no rotation"),
        (lambda targets: np.concatenate([targets[:, :6], targets[:, 3:6]], axis=1), "row 0 is no rotation"),
    ],
    ids=["one row", "six columns", "NaN", "infinite", "scaled", "one direction twice"],
)
def test_targets_that_are_no_poses_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        solve_adam(ARM, change(reachable(4)), config=QUICK)
