import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends
from planar_arm import LIMIT, MAPPING, PLANAR_ARM
from poses import ORIENTATION_TOLERANCE, POSITION_TOLERANCE, reachable, unreachable

from qjrl.geometry.pose import row_errors
from qjrl.robot import bends_from_cables, cable_lengths, forward_kinematics, in_precision, robot_from_mapping
from qjrl.robot.kinds import KINDS
from qjrl.solvers import FollowConfig, LeastSquaresConfig, PoseFollower, solve_least_squares
from qjrl.solvers.least_squares import RoundConfig

ARM = arm_named("qj_2222")
CONFIG = FollowConfig()
LIMIT_OF_BENDS = np.sin(float(ARM.bend_limit) / 2.0)


def sagging(lengths):
    """A stand-in for a learned model: the bends fall short by a twentieth and lean to one side."""
    return forward_kinematics(ARM, 0.95 * bends_from_cables(ARM, lengths) + 0.01)


@pytest.fixture(scope="module")
def follower():
    return PoseFollower(ARM)


ASIDE = np.array(
    [[0.15, 0.0], [0.0, 0.12], [-0.1, 0.1], [0.05, -0.15]]
)  # at home a redundant arm has no way up or down


def walk(count: int, share: float, seed: int = 0, size: float = 0.004) -> np.ndarray:
    """Bends (count, segments, 2) of a random walk from `ASIDE`, within a share of the limit."""
    random, largest = np.random.default_rng(seed), share * LIMIT_OF_BENDS
    bends, velocity = np.tile(ASIDE, (count, 1, 1)), np.zeros(ASIDE.shape)
    for number in range(1, count):
        velocity = 0.9 * velocity + size * np.sqrt(1.0 - 0.9**2) * random.normal(size=velocity.shape)
        moved = bends[number - 1] + velocity
        bends[number] = moved * np.minimum(1.0, largest / np.linalg.norm(moved, axis=1, keepdims=True))
    return bends


def followed(follower, targets, start, noise=0.0, seed=0):
    """Answers to targets (n, 9), each begun where the last ended, give or take what encoders do not see."""
    random, answers = np.random.default_rng(seed), []
    for target in targets:
        answers.append(follower.solve(target, start + noise * random.normal(size=start.shape)))
        start = answers[-1].configuration
    return answers


def poses_of(bends) -> np.ndarray:
    return over_rows(forward_kinematics, ARM, np.asarray(bends))


def vectors_of(bends) -> np.ndarray:
    """The kind's coordinates of one configuration, on the host: quick."""
    size = np.maximum(np.linalg.norm(bends, axis=-1, keepdims=True), 1e-12)
    return 2.0 * np.arcsin(size) * bends / size


def size_of_move(one, other) -> float:
    """Between two configurations, in the coordinates of the kind [rad]."""
    return float(np.linalg.norm(vectors_of(one) - vectors_of(other)))


def test_an_answer_is_exact_by_the_kinematics_evaluated_again(follower):
    bends = random_bends(ARM, 40, seed=3, share=0.7)
    targets = poses_of(bends)
    starts = bends + 0.01 * np.random.default_rng(0).normal(size=bends.shape)
    answers = [follower.solve(target, start) for target, start in zip(targets, starts, strict=True)]
    lengths = np.stack([one.cable_lengths for one in answers])
    np.testing.assert_allclose(
        lengths, over_rows(cable_lengths, ARM, [one.configuration for one in answers]), atol=1e-15
    )
    position, orientation = row_errors(poses_of(over_rows(bends_from_cables, ARM, lengths)), targets)
    assert all(one.converged for one in answers)
    assert position.max() < 1e-3 * POSITION_TOLERANCE and orientation.max() < 1e-3 * ORIENTATION_TOLERANCE
    np.testing.assert_allclose([one.position_error for one in answers], position, atol=1e-12)
    np.testing.assert_allclose([one.orientation_error for one in answers], orientation, atol=1e-9)


@pytest.mark.parametrize("noise", [0.0, 0.003], ids=["from the last answer", "from noisy joints"])
def test_a_random_walk_is_followed_without_a_jump(follower, noise):
    bends = walk(400, share=0.45)
    answers = followed(follower, poses_of(bends), bends[0], noise)
    assert all(one.converged for one in answers)
    configurations = [bends[0], *[one.configuration for one in answers]]
    moves = np.array([size_of_move(*pair) for pair in itertools.pairwise(configurations)])
    walked = max(size_of_move(*pair) for pair in itertools.pairwise(bends))
    assert moves.max() < 2.0 * walked + 10.0 * noise


def test_half_a_step_of_the_target_is_half_a_move(follower):
    bends = random_bends(ARM, 12, seed=9, share=0.6)
    aside = np.random.default_rng(1).normal(size=bends.shape)
    for one, direction in zip(bends, aside, strict=True):
        for size in (0.02, 0.002, 0.0002):
            moved = one + size * direction
            answer = follower.solve(poses_of(moved[None])[0], one)
            home_share = CONFIG.posture * size_of_move(one, np.zeros_like(one))
            assert (
                answer.converged
                and size_of_move(answer.configuration, one) < 1.5 * size_of_move(moved, one) + home_share
            )


def test_whatever_is_asked_a_call_moves_no_farther_than_its_bound_and_within_the_limits(follower):
    targets = np.concatenate([reachable(ARM, 60, seed=1), unreachable(ARM)])
    starts = random_bends(ARM, len(targets), seed=2)
    for target, start in zip(targets, starts, strict=True):
        answer = follower.solve(target, start)
        assert np.isfinite(answer.configuration).all() and np.isfinite(answer.cable_lengths).all()
        assert np.linalg.norm(answer.configuration, axis=1).max() <= LIMIT_OF_BENDS + 1e-12
        assert size_of_move(answer.configuration, start) <= CONFIG.largest_move + 1e-9


def test_limits_are_kept_on_a_walk_that_runs_into_them(follower):
    bends = walk(400, share=1.0, size=0.02)
    assert (np.linalg.norm(bends, axis=2) > 0.999 * LIMIT_OF_BENDS).mean() > 0.05
    answers = followed(follower, poses_of(bends), bends[0])
    assert np.linalg.norm([one.configuration for one in answers], axis=2).max() <= LIMIT_OF_BENDS + 1e-12
    assert np.mean([one.converged for one in answers]) > 0.5


def test_a_start_beyond_the_limits_is_brought_back(follower):
    start = np.tile([1.03 * LIMIT_OF_BENDS, 0.0], (4, 1))
    answer = follower.solve(poses_of(0.97 * start[None])[0], start)
    assert np.linalg.norm(answer.configuration, axis=1).max() <= LIMIT_OF_BENDS + 1e-12
    assert answer.converged


def test_from_a_bad_start_the_target_is_reached_in_some_calls(follower):
    targets, starts = reachable(ARM, 20, seed=5, share=0.6), random_bends(ARM, 20, seed=6, share=0.6)
    ends = [followed(follower, [target] * 40, start)[-1] for target, start in zip(targets, starts, strict=True)]
    assert (
        np.mean([one.converged for one in ends]) >= 0.8
    )  # the others end at limits: a way round them is another branch


def test_out_of_reach_calls_end_at_a_pose_that_no_descent_from_there_betters(follower):
    one_start = LeastSquaresConfig(rounds=(RoundConfig(1, 60),), num_candidates=16, batch_size=16, least_tension=0.0)
    weigh = lambda position, orientation: position**2 + (CONFIG.descent.rotation_weight * orientation) ** 2  # noqa: E731
    beyond = reachable(ARM, 4, seed=3, share=0.5) * np.where(np.arange(9) < 3, 1.3, 1.0)
    for target in [unreachable(ARM)[0], *beyond]:
        end = followed(follower, [target] * 100, ASIDE)[-1]
        best = solve_least_squares(ARM, target[None], end.configuration, one_start)
        found = weigh(end.position_error, end.orientation_error)
        assert not end.converged and end.position_error > 0.01
        assert found <= weigh(float(best.position_error[0]), float(best.orientation_error[0])) * (1.0 + 1e-4)


def test_half_a_turn_away_is_not_converged(follower):
    home = np.zeros((4, 2))
    target = poses_of(home[None])[0].copy()
    target[3:] = [1.0, 0.0, 0.0, 0.0, -1.0, 0.0]
    answer = follower.solve(target, home)
    assert not answer.converged and answer.orientation_error > 2.0


def test_at_a_pose_that_is_held_the_arm_forgets_how_it_came_there(follower):
    one = random_bends(ARM, 1, seed=8, share=0.5)[0]
    target = poses_of(one[None])[0]
    other = followed(follower, [target] * 40, one + 0.2 * np.random.default_rng(3).normal(size=one.shape))[
        -1
    ].configuration
    ends = [
        followed(follower, [target] * 300, start, noise=0.002, seed=number) for number, start in enumerate((one, other))
    ]
    assert all(answer.converged for answers in ends for answer in answers)
    assert size_of_move(other, one) > 0.1
    assert size_of_move(ends[0][-1].configuration, ends[1][-1].configuration) < 0.5 * size_of_move(other, one)


def test_a_model_is_followed_from_what_its_joints_say():
    follower, bends = PoseFollower(ARM, sagging), walk(120, share=0.45, seed=4)
    lengths = over_rows(cable_lengths, ARM, bends)
    targets, start, answers = np.asarray(jax.vmap(sagging)(lengths)), 0.95 * bends[0] + 0.01, []
    for target in targets:
        answers.append(follower.solve(target, start))
        start = 0.95 * answers[-1].configuration + 0.01  # where the arm is, not what it was told
    assert all(one.converged for one in answers)
    poses = jax.vmap(sagging)(jnp.asarray([one.cable_lengths for one in answers]))
    position, orientation = row_errors(poses, targets)
    assert position.max() < POSITION_TOLERANCE and orientation.max() < ORIENTATION_TOLERANCE
    np.testing.assert_allclose([one.position_error for one in answers], position, atol=1e-12)


def test_another_kind_of_robot_is_followed_too():
    KINDS["planar_arm"] = PLANAR_ARM
    try:
        arm = robot_from_mapping(MAPPING)
        angles = np.stack([np.sin(np.linspace(0.1, 6.0, 100)), 0.9 + 0.2 * np.cos(np.linspace(0.0, 6.0, 100))], axis=1)
        targets = over_rows(forward_kinematics, arm, angles)
        answers = followed(PoseFollower(arm), targets, angles[0])
        beyond = followed(PoseFollower(arm), [over_rows(forward_kinematics, arm, [[1.5, 0.5]])[0]] * 20, np.zeros(2))[
            -1
        ]
    finally:
        del KINDS["planar_arm"]
    assert all(one.converged for one in answers)
    np.testing.assert_allclose([one.configuration for one in answers], angles, atol=1e-4)
    assert not beyond.converged and np.abs(beyond.configuration).max() == pytest.approx(LIMIT)


def test_answers_are_the_same_every_time(follower):
    bends = random_bends(ARM, 5, seed=12)
    for target, start in zip(poses_of(bends), bends * 0.98, strict=True):
        first, second = follower.solve(target, start), follower.solve(target, start)
        assert all(np.array_equal(one, other) for one, other in zip(first, second, strict=True))


def test_a_hundred_calls_compile_nothing(follower, caplog):
    bends = walk(100, share=0.5)
    targets = poses_of(bends)
    follower.solve(targets[0], bends[0])
    with jax.log_compiles():
        followed(follower, targets, bends[0])
        assert not caplog.records
        jax.jit(lambda x: x * 1.2345)(1.0)  # what would be seen
        assert "Compiling" in caplog.text


def test_a_robot_in_single_precision_is_followed_in_it():
    arm, bends = in_precision(ARM, "float32"), random_bends(ARM, 3, seed=1, share=0.5)
    follower = PoseFollower(arm, config=dataclasses.replace(CONFIG, iterations=4))
    for target, start in zip(poses_of(bends), bends * 0.99, strict=True):
        answer = follower.solve(target, start)
        assert answer.configuration.dtype == np.float32 and answer.converged


GOOD = reachable(ARM, 1)[0]
START = np.zeros((4, 2))


@pytest.mark.parametrize(
    ("target", "start", "message"),
    [
        (GOOD[None], START, r"target: got the shape \(1, 9\), allowed: \(9,\)"),
        (np.full(9, np.nan), START, "target: got nan at"),
        (np.where(np.arange(9) == 4, np.inf, GOOD), START, r"target: got inf at \[4\]"),
        (np.ones(9), START, "is no rotation"),
        (np.where(np.arange(9) == 2, 1e3, GOOD), START, "from the base, allowed"),
        (["a"] * 9, START, "target: got"),
        (np.ma.masked_array(GOOD), START, "target: got a masked array"),
        (GOOD, np.zeros((3, 2)), r"configuration: got the shape \(3, 2\), allowed: \(4, 2\)"),
        (GOOD, np.full((4, 2), np.nan), "configuration: got nan"),
        (GOOD, np.full((4, 2), 0.9), "got a bend of length"),
        (GOOD, np.full((4, 2), 1j), "configuration: got complex"),
    ],
)
def test_what_is_no_question_is_refused_in_one_line(follower, target, start, message):
    with pytest.raises(ValueError, match=message) as refused:
        follower.solve(target, start)
    assert "\n" not in str(refused.value)


def test_lists_and_jax_arrays_are_taken_as_well(follower):
    expected = follower.solve(GOOD, START)
    for target, start in ((GOOD.tolist(), START.tolist()), (jnp.asarray(GOOD), jnp.asarray(START))):
        np.testing.assert_array_equal(follower.solve(target, start).cable_lengths, expected.cable_lengths)
