import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, random_bends
from poses import assert_sound, reachable, turned, turned_bends, unreachable
from scipy.spatial.transform import Rotation

from qjrl.robot import bends_from_angles
from qjrl.robot.quaternion_arm.fabrik import rodrigues, turn_about_goal
from qjrl.robot.quaternion_arm.fabrik_model import segment_lengths, state_of, virtual_arm
from qjrl.robot.quaternion_arm.fabrik_reach import goal_of, reach_backward, reach_forward
from qjrl.robot.quaternion_arm.joint import joint_transform
from qjrl.robot.quaternion_arm.kinematics import frames
from qjrl.solvers import FabrikConfig, Status, solve_fabrik

ARM = arm_named("rolling_312")  # odd and even segments
CONFIG = FabrikConfig(batch_size=16, outer_iterations=150)


def chain(arm, count, bend):
    """Frames (position, rotation) along one segment, the base first."""
    position, rotation = np.zeros(3), np.eye(3)
    passed = [(position, rotation)]
    offset, turn = (np.asarray(part) for part in joint_transform(arm, bend))
    for _ in range(count):
        position, rotation = position + rotation @ offset, rotation @ turn
        position = position + rotation[:, 2] * float(arm.link_length)
        passed.append((position, rotation))
    return passed


@pytest.mark.parametrize("name", ["rolling_312", "spherical_312"])
@pytest.mark.parametrize("count", range(1, 7))
def test_lengths_reach_where_the_lines_along_both_ends_meet(name, count):
    """The least-squares intersection of the base's axis with the line through the end: no formula of the paper."""
    arm = arm_named(name)
    angle = np.radians(150.0) / count if count > 2 else 0.9
    passed = chain(arm, count, bends_from_angles(jnp.array(0.7), jnp.array(angle)))
    (end, rotation), up = passed[-1], np.array([0.0, 0.0, 1.0])
    (before, after), residual, *_ = np.linalg.lstsq(np.stack([up, rotation[:, 2]], axis=1), end, rcond=None)
    assert residual < 1e-28  # the lines do meet
    found = segment_lengths(arm, count, jnp.array(angle))
    np.testing.assert_allclose(found, (before, after), rtol=1e-12)


def test_lengths_of_a_straight_segment_are_halves_of_it():
    before, after = segment_lengths(ARM, 3, jnp.array(0.0))
    height = float(frames(ARM, jnp.zeros((3, 2)))[0, 2])
    np.testing.assert_allclose(before + after, 3 * (height + float(ARM.link_length)), rtol=1e-14)
    np.testing.assert_allclose(after - before, ARM.link_length, rtol=1e-14)


def test_lengths_stay_finite_where_the_lines_are_parallel():
    for angle in (np.pi / 3, np.pi):
        assert np.isfinite(segment_lengths(ARM, 3, jnp.array(angle))).all()


def segment_ends(bends):
    """(segments, 9) pose of the end of every segment."""
    return frames(ARM, jnp.asarray(bends))[np.cumsum(ARM.joints_per_segment) * 2 - 1]


def test_the_virtual_arm_passes_through_the_segments_ends_and_gives_its_state_back():
    for bends in random_bends(ARM, 4, share=0.8):
        arm = virtual_arm(ARM, jnp.asarray(bends))
        ends = segment_ends(bends)
        np.testing.assert_allclose(arm.ends, ends[:, :3], atol=1e-14)
        np.testing.assert_allclose(arm.end_directions, np.cross(ends[:, 3:6], ends[:, 6:]), atol=1e-13)
        np.testing.assert_allclose(arm.bases[1:], arm.ends[:-1], atol=0)
        np.testing.assert_allclose(state_of(ARM, arm), bends, atol=1e-14)


def test_reaching_leaves_an_arm_that_is_there_where_it_is():
    bends = jnp.asarray(random_bends(ARM, 1, share=0.8)[0])
    arm, goal = virtual_arm(ARM, bends), goal_of(segment_ends(bends)[-1])
    for reached in (reach_forward(ARM, arm, goal), reach_backward(ARM, arm, goal)):
        for found, expected in zip(jax.tree.leaves(reached), jax.tree.leaves(arm), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-12)


def test_each_stage_holds_its_own_end():
    arm, goal = virtual_arm(ARM, jnp.zeros((3, 2))), goal_of(jnp.asarray(reachable(ARM, 1)[0]))
    forward = reach_forward(ARM, arm, goal)
    np.testing.assert_allclose(forward.ends[-1], goal.position, atol=1e-15)
    np.testing.assert_allclose(forward.end_directions[-1], goal.z_axis, atol=1e-15)
    backward = reach_backward(ARM, forward, goal)
    np.testing.assert_array_equal(backward.bases[0], np.zeros(3))
    np.testing.assert_array_equal(backward.base_directions[0], [0.0, 0.0, 1.0])


def test_the_turn_is_the_right_handed_one_about_the_goal():
    axis, angle = np.array([0.6, 0.0, 0.8]), 0.7
    expected = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(rodrigues(jnp.asarray(axis), jnp.array(angle)), expected, atol=1e-15)
    target = jnp.asarray(reachable(ARM, 1)[0])
    goal, arm = goal_of(target), virtual_arm(ARM, jnp.zeros((3, 2)))
    turned_arm = turn_about_goal(arm, goal, jnp.array(angle))
    about = Rotation.from_rotvec(angle * np.asarray(goal.z_axis))
    np.testing.assert_allclose(
        turned_arm.joints - goal.position, about.apply(np.asarray(arm.joints - goal.position)), atol=1e-14
    )


@pytest.fixture(scope="module")
def solved():
    targets = reachable(ARM, 16, share=0.5)
    return targets, solve_fabrik(ARM, targets, config=CONFIG)


def test_what_converged_is_there(solved):
    targets, result = solved
    assert_sound(ARM, result, targets)
    assert np.mean(result.converged) >= 0.4


def test_a_start_nearby_needs_fewer_iterations(solved):
    targets, cold = solved
    warm = solve_fabrik(ARM, targets, np.asarray(cold.bends) * 0.99, CONFIG)
    rows = np.asarray(cold.converged)
    assert np.all(np.asarray(warm.converged)[rows])
    assert np.mean(np.asarray(warm.steps)[rows]) < 0.6 * np.mean(np.asarray(cold.steps)[rows])


def test_turning_a_target_about_the_base_turns_the_answer(solved):
    targets, result = solved
    again = solve_fabrik(ARM, turned(targets, 2.0), config=CONFIG)
    rows = np.asarray(result.converged)
    np.testing.assert_array_equal(again.status, result.status)
    np.testing.assert_allclose(np.asarray(again.bends)[rows], turned_bends(result.bends, 2.0)[rows], atol=1e-6)


def test_unreachable_targets_come_back_not_converged_and_finite():
    targets = unreachable(ARM)
    result = solve_fabrik(ARM, targets, config=CONFIG)
    assert_sound(ARM, result, targets)
    assert not np.any(result.converged)


def test_an_answer_beyond_the_limits_is_not_converged():
    narrow = dataclasses.replace(ARM, bend_limit_deg=math.degrees(0.05))
    targets = reachable(ARM, 16, share=0.5)
    result = solve_fabrik(narrow, targets, config=CONFIG)
    assert_sound(narrow, result, targets)
    assert np.sum(np.asarray(result.status) == Status.OUTSIDE_LIMITS) >= 8


@pytest.mark.parametrize(
    ("targets", "bends", "message"),
    [
        (np.full((2, 9), np.nan), None, "targets: got non-finite values in row 0"),
        (np.zeros((2, 8)), None, r"targets: got shape \(2, 8\)"),
        (np.ones((1, 9)), None, "row 0 is no rotation"),
        (reachable(ARM, 2), np.zeros((4, 2)), r"initial_bends: got shape \(4, 2\), allowed: \(3, 2\) or \(2, 3, 2\)"),
        (reachable(ARM, 2), np.full((3, 2), np.nan), "initial_bends: got non-finite"),
        (
            reachable(ARM, 2),
            np.full((2, 3, 2), 0.9),
            r"^initial_bends: segment 0 \(the first is 0\): got a bend of length 1\.27",
        ),
    ],
    ids=["NaN", "eight columns", "no rotation", "four segments", "NaN bends", "half turns"],
)
def test_what_is_no_question_is_refused(targets, bends, message):
    with pytest.raises(ValueError, match=message):
        solve_fabrik(ARM, targets, bends, CONFIG)
