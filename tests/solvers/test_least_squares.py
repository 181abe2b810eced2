import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends
from poses import assert_sound, reachable, turned, turned_bends, unreachable

from qjrl.geometry.pose import row_errors
from qjrl.robot import bends_from_cables, cable_lengths, cable_strokes, forward_kinematics
from qjrl.robot.quaternion_arm.differential import tip_of
from qjrl.simulation import settle
from qjrl.solvers import LeastSquaresConfig, Status, draw_candidates, least_squares, solve_least_squares
from qjrl.solvers.least_squares import RoundConfig
from qjrl.solvers.levenberg_marquardt import Residual, damped_step
from qjrl.solvers.model_tip import exact_tip_function

ARM = arm_named("qj_2222")
CONFIG = LeastSquaresConfig(num_candidates=1024, batch_size=16)
ONE_START = dataclasses.replace(CONFIG, rounds=(RoundConfig(1, 60),), least_tension=0.0)
CANDIDATES = draw_candidates(ARM, CONFIG)


@pytest.fixture(scope="module")
def solved():
    targets = reachable(ARM, 48)
    return targets, solve_least_squares(ARM, targets, config=CONFIG, candidates=CANDIDATES)


def test_all_targets_within_the_limits_are_reached(solved):
    targets, result = solved
    assert_sound(ARM, result, targets)
    assert np.all(result.converged)


def test_no_joint_leaves_its_limit(solved):
    _, result = solved
    angle = 2.0 * np.arcsin(np.linalg.norm(result.bends, axis=-1))
    assert angle.max() <= float(ARM.bend_limit) + 1e-12


def test_rows_do_not_depend_on_their_neighbours_or_on_padding(solved):
    targets, result = solved
    alone = solve_least_squares(ARM, targets[5:8], config=CONFIG, candidates=CANDIDATES)
    np.testing.assert_array_equal(alone.cable_lengths, np.asarray(result.cable_lengths)[5:8])
    np.testing.assert_array_equal(alone.steps, np.asarray(result.steps)[5:8])


def test_a_start_nearby_needs_fewer_iterations(solved):
    targets, cold = solved
    warm = solve_least_squares(ARM, targets, np.asarray(cold.bends) * 0.999, CONFIG, CANDIDATES)
    assert np.all(warm.converged)
    assert np.mean(warm.steps) < 0.6 * np.mean(cold.steps)


def test_turning_a_target_about_the_base_turns_the_answer(solved):
    targets, _ = solved
    home = np.zeros((4, 2))
    first = solve_least_squares(ARM, targets[:16], home, ONE_START, CANDIDATES)
    again = solve_least_squares(ARM, turned(targets[:16], 2.0), home, ONE_START, CANDIDATES)
    rows = np.asarray(first.converged)
    assert rows.mean() > 0.6
    np.testing.assert_array_equal(again.steps, first.steps)
    np.testing.assert_allclose(np.asarray(again.bends)[rows], turned_bends(first.bends, 2.0)[rows], atol=1e-9)


@pytest.fixture(scope="module")
def loose(solved):
    """The same targets, whatever the strands carry."""
    targets, _ = solved
    return solve_least_squares(
        ARM, targets, config=dataclasses.replace(CONFIG, least_tension=0.0), candidates=CANDIDATES
    )


def test_answers_say_what_the_least_loaded_strand_carries(loose):
    rest = settle(ARM, loose.cable_lengths)
    np.testing.assert_allclose(loose.least_tension, rest.strand_tension.min(axis=1), atol=0.02)
    assert rest.is_slack.any()


def test_of_a_targets_answers_one_that_keeps_all_strands_taut_is_taken(solved, loose):
    _, taut = solved
    before, after = np.asarray(loose.least_tension), np.asarray(taut.least_tension)
    was_loose = before < CONFIG.least_tension
    assert np.mean(was_loose) > 0.1 and np.mean(after < CONFIG.least_tension) < 0.3 * np.mean(was_loose)
    assert np.all(after[was_loose] >= before[was_loose]) and np.all(taut.converged)
    np.testing.assert_array_equal(taut.cable_lengths[~was_loose], loose.cable_lengths[~was_loose])
    rest = settle(ARM, taut.cable_lengths)
    np.testing.assert_allclose(after, rest.strand_tension.min(axis=1), atol=0.02)


@pytest.fixture(scope="module")
def out_of_reach():
    """Straight up at 1 m; at 5 m; home turned upside down; below the base."""
    upright = np.asarray(forward_kinematics(ARM, jnp.zeros((4, 2))))[None].copy()
    upright[0, 2] = 1.0
    targets = np.concatenate([upright, unreachable(ARM)])
    return targets, solve_least_squares(ARM, targets, config=CONFIG, candidates=CANDIDATES)


def test_a_target_out_of_reach_is_flagged_and_its_answer_finite_and_feasible(out_of_reach):
    targets, result = out_of_reach
    assert_sound(ARM, result, targets)
    assert np.asarray(result.status).tolist() == [Status.NEAREST] * len(targets)
    assert np.linalg.norm(result.bends, axis=-1).max() <= np.sin(float(ARM.bend_limit) / 2.0) + 1e-9


def test_the_nearest_to_what_lies_straight_above_is_the_straight_arm(out_of_reach):
    _, result = out_of_reach
    home = np.asarray(forward_kinematics(ARM, jnp.zeros((4, 2))))
    np.testing.assert_allclose(result.bends[0], 0.0, atol=1e-3)
    assert float(result.position_error[0]) == pytest.approx(1.0 - home[2], abs=1e-6)


def weighted_cost(targets, lengths):
    poses = over_rows(forward_kinematics, ARM, over_rows(bends_from_cables, ARM, lengths))
    position, orientation = row_errors(poses, targets)
    return position**2 + (CONFIG.descent.rotation_weight * orientation) ** 2


def test_no_feasible_pose_nearby_or_far_is_nearer(out_of_reach):
    targets, result = out_of_reach
    cost, limit = weighted_cost(targets, result.cable_lengths), np.sin(float(ARM.bend_limit) / 2.0)
    near = np.asarray(result.bends) + 0.01 * np.random.default_rng(0).normal(size=(200, len(targets), 4, 2))
    far = random_bends(ARM, 2000, seed=7)
    for row, target in enumerate(targets):
        bends = np.concatenate([near[:, row], far])
        bends *= np.minimum(1.0, limit / np.linalg.norm(bends, axis=-1, keepdims=True))
        others = weighted_cost(np.tile(target, (len(bends), 1)), over_rows(cable_lengths, ARM, bends))
        assert others.min() > cost[row] * (1.0 - 1e-6)


def test_bends_within_their_limit_keep_every_cable_within_its_stroke():
    bends = random_bends(ARM, 2000, seed=11)
    bends = bends * np.sin(float(ARM.bend_limit) / 2.0) / np.linalg.norm(bends, axis=-1, keepdims=True)  # at the limit
    assert np.all(np.abs(over_rows(cable_lengths, ARM, bends)) <= np.asarray(cable_strokes(ARM)) + 1e-12)


def test_the_step_solves_the_damped_normal_equations():
    random = np.random.default_rng(0)
    jacobian, error, damping = random.normal(size=(6, 8, 5)), random.normal(size=(6, 5)), random.uniform(0.01, 1, 5)
    step = damped_step(Residual(jnp.asarray(error), jnp.asarray(jacobian)), jnp.asarray(damping), 1e9)
    for row in range(5):
        J = jacobian[..., row]
        normal = J.T @ J + damping[row] * np.sum(J**2) * np.eye(8)
        np.testing.assert_allclose(step[:, row], np.linalg.solve(normal, J.T @ error[:, row]), rtol=1e-10)


def test_a_step_is_shortened_to_its_bound():
    residual = Residual(jnp.full((6, 1), 1e3), jnp.asarray(np.random.default_rng(0).normal(size=(6, 8, 1))))
    assert np.linalg.norm(damped_step(residual, jnp.array([1e-3]), 1.0)) == pytest.approx(1.0)


def test_no_round_at_all_is_refused():
    with pytest.raises(ValueError, match="at least one round"):
        LeastSquaresConfig(rounds=())


@pytest.mark.parametrize(
    ("targets", "bends", "message"),
    [
        (np.full((2, 9), np.nan), None, "targets: got non-finite values in row 0"),
        (np.zeros(9), None, r"targets: got shape \(9,\)"),
        (np.ones((1, 9)), None, "row 0 is no rotation"),
        (reachable(ARM, 2), np.zeros((3, 2)), r"initial_bends: got shape \(3, 2\)"),
    ],
    ids=["NaN", "one row", "no rotation", "three segments"],
)
def test_what_is_no_question_is_refused(targets, bends, message):
    with pytest.raises(ValueError, match=message):
        solve_least_squares(ARM, targets, bends, CONFIG, CANDIDATES)


def sagging(lengths):
    """A stand-in for a learned model: the bends fall short by a twentieth and lean to one side."""
    return forward_kinematics(ARM, 0.95 * bends_from_cables(ARM, lengths) + 0.01)


def test_a_model_is_inverted_along_the_closed_forms_jacobian():
    commanded = over_rows(cable_lengths, ARM, random_bends(ARM, 24, seed=5))
    targets = np.asarray(jax.vmap(sagging)(commanded))
    result = solve_least_squares(ARM, targets, config=CONFIG, candidates=CANDIDATES, model=sagging)
    assert np.all(result.converged)
    poses = jax.vmap(sagging)(jnp.asarray(result.cable_lengths))
    position, orientation = row_errors(poses, targets)
    np.testing.assert_allclose(result.position_error, position, atol=1e-12)
    assert position.max() <= 1e-5 and orientation.max() <= np.radians(0.01)
    assert np.median(result.steps) <= 8


def test_where_no_tension_is_asked_for_the_closed_forms_answer_on_the_way_is_not_evaluated(monkeypatch):
    evaluated, evaluate = [], least_squares._evaluate
    monkeypatch.setattr(least_squares, "_evaluate", lambda *given: evaluated.append(given) or evaluate(*given))
    targets, config = reachable(ARM, 6, seed=4, share=0.8), dataclasses.replace(CONFIG, least_tension=0.0)
    at_once = solve_least_squares(ARM, targets, config=config, candidates=CANDIDATES, model=sagging)
    assert len(evaluated) == 1
    nominal = solve_least_squares(ARM, targets, config=config, candidates=CANDIDATES)
    in_turns = solve_least_squares(ARM, targets, nominal.bends, config, CANDIDATES, sagging)
    np.testing.assert_allclose(at_once.cable_lengths, in_turns.cable_lengths, atol=1e-9)
    np.testing.assert_allclose(at_once.least_tension, in_turns.least_tension, atol=1e-5)


def test_what_is_out_of_a_models_reach_gets_the_models_nearest_pose():
    targets = np.asarray(forward_kinematics(ARM, jnp.zeros((4, 2))))[None].copy()
    targets[0, 2] = 1.0
    result = solve_least_squares(ARM, targets, config=CONFIG, candidates=CANDIDATES, model=sagging)
    assert int(result.status[0]) == Status.NEAREST
    np.testing.assert_allclose(0.95 * result.bends[0] + 0.01, 0.0, atol=2e-3)  # the sagging arm is straight


def test_the_jacobian_of_a_model_is_the_closed_forms_where_the_model_is():
    exact = exact_tip_function(lambda lengths: forward_kinematics(ARM, bends_from_cables(ARM, lengths)))
    vectors = jnp.moveaxis(jnp.asarray(random_bends(ARM, 3, seed=2)), 0, -1)
    for found, expected in zip(
        jax.tree.leaves(exact(ARM, vectors.reshape(8, 3))), jax.tree.leaves(tip_of(ARM, vectors)), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-10)
