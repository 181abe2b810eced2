"""Inverse kinematics by FABRIK (paper 000, section 3): virtual model, inner iteration, outer iteration for the roll."""

import dataclasses
import functools
import math
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from qjrl.config import Range, configuration
from qjrl.robot.batching import in_batches
from qjrl.robot.ik_result import SolveResult, Status, check_initial_configurations, check_targets, describe_solution
from qjrl.robot.pose_model import ClosedForm
from qjrl.robot.quaternion_arm.arm import QuaternionArm, require_arm
from qjrl.robot.quaternion_arm.fabrik_model import VirtualArm, angle_between, state_of, tip_x_axis, virtual_arm
from qjrl.robot.quaternion_arm.fabrik_reach import Goal, goal_of, reach, tip_distance
from qjrl.robot.verbs import cable_lengths


@configuration
class FabrikConfig:
    """Iterations and tolerances; the paper prints the tolerances alone (section 5.2), the rest is ours."""

    relaxation: Annotated[float, Range(above=0.0, high=10.0)] = 1.0
    """lambda of Eq. 14: what part of the roll error an outer iteration turns the arm by."""
    inner_iterations: Annotated[int, Range(1, 10_000)] = 10
    """Forward and backward stages of one outer iteration, at most."""
    outer_iterations: Annotated[int, Range(1, 100_000)] = 2500
    """Turns of the whole arm, at most."""
    patience: Annotated[int, Range(1, 10_000)] = 20
    """Outer iterations after which progress is looked at."""
    reversal: Annotated[float, Range(0.0, 1.0)] = 0.0
    """The turn changes its sign when the roll error fell by less than this share since the last look; 0: never (the paper)."""
    position_tolerance: Annotated[float, Range(above=0.0)] = 1e-5
    """Position error that counts as converged [m]."""
    orientation_tolerance: Annotated[float, Range(above=0.0)] = math.radians(0.01)
    """Orientation error that counts as converged [rad]; the pointing direction holds exactly, so it is the roll's."""
    batch_size: Annotated[int, Range(1, 65536)] = 64
    """Targets solved together."""


def solve_fabrik(
    robot: Any, targets: Any, initial_bends: Any = None, config: FabrikConfig = FabrikConfig()
) -> SolveResult:
    """Cable lengths by FABRIK from the current state, in the arm's nominal kinematics.

    Joint limits are not part of the algorithm: an answer beyond them comes back as not converged, OUTSIDE_LIMITS.

    Args:
        robot: the arm.
        targets: (n, 9) poses [m, -].
        initial_bends: the current state q_0, (n, segments, 2) or (segments, 2); default: home.
        config: iterations, relaxation, tolerances.
    Returns:
        `steps` counts inner iterations.
    Raises:
        ValueError: targets of the wrong shape, non-finite, or no rotations; initial bends of another shape.
    """
    require_arm(robot, "FABRIK")
    checked, ends = check_targets(robot, targets), watch_fabrik(robot, targets, initial_bends, config)
    function = functools.partial(_evaluate_rows, config, robot)
    return jax.tree.map(jnp.asarray, in_batches(function, config.batch_size, checked, ends))


@struct.dataclass
class Progress:
    """State between outer iterations, of one target or of a batch."""

    arm: VirtualArm
    relaxation: Float[Array, "*targets"]
    """lambda, with the sign of the present turn."""
    roll_before: Float[Array, "*targets"]
    """Roll error at the last look [rad]."""
    joints_before: Float[Array, "*targets segments 3"]
    """P_j at the last look [m]."""
    turns: Int[Array, "*targets"]
    """Outer iterations spent."""
    steps: Int[Array, "*targets"]
    """Inner iterations spent."""
    is_near: Bool[Array, "*targets"]
    has_stalled: Bool[Array, "*targets"]
    """At the last look the arm was where it had been at the one before."""


def watch_fabrik(
    robot: Any, targets: Any, initial_bends: Any = None, config: FabrikConfig = FabrikConfig()
) -> Progress:
    """How FABRIK ends at every target: turns spent, whether it is near or has stalled; joint limits are ignored.

    Args:
        targets: (n, 9) poses [m, -].
        initial_bends: as for `solve_fabrik`.
    """
    require_arm(robot, "FABRIK")
    checked = check_targets(robot, targets)
    home = np.zeros((robot.num_segments, 2))
    bends = check_initial_configurations(robot, home if initial_bends is None else initial_bends, len(checked))
    state = in_batches(functools.partial(_begin_rows, config, robot), config.batch_size, bends)
    for limit in _looks(config.outer_iterations):
        rows = np.flatnonzero(_is_going(config, state, limit))
        if len(rows):
            advance = functools.partial(_advance_rows, config, robot, np.int32(limit))
            moved = in_batches(advance, config.batch_size, checked[rows], _rows_of(state, rows))
            state = _with_rows(state, rows, moved)
    return state


def _looks(outer_iterations: int) -> list[int]:
    """25, 50, 100, ...: after so many turns those that are done leave their batch, which would wait for the slowest."""
    looks = [_FIRST_LOOK]
    while looks[-1] < outer_iterations:
        looks.append(2 * looks[-1])
    return [min(look, outer_iterations) for look in looks]


def _rows_of(state: Progress, rows: np.ndarray) -> Progress:
    return jax.tree.map(lambda values: values[rows], state)


def _with_rows(state: Progress, rows: np.ndarray, moved: Progress) -> Progress:
    def replaced(values: np.ndarray, new: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[rows] = new
        return values

    return jax.tree.map(replaced, state, moved)


def advance_one(
    robot: QuaternionArm, config: FabrikConfig, limit: Int[Array, ""], target: Float[Array, "9"], state: Progress
) -> Progress:
    """The outer iteration, until the pose is reached, nothing moves, or `limit` turns are spent."""
    goal = goal_of(target)
    return jax.lax.while_loop(
        lambda state: _is_going(config, state, limit), lambda state: _iterate(robot, config, goal, state), state
    )


def roll_error(robot: QuaternionArm, arm: VirtualArm, goal: Goal) -> Float[Array, ""]:
    """psi between X_end and X_d [rad]: Eq. 13, with the sign of the turn about Z_d that closes it (ours)."""
    x_end = tip_x_axis(robot, state_of(robot, arm))
    return jnp.sign(jnp.dot(goal.z_axis, jnp.cross(x_end, goal.x_axis))) * angle_between(x_end, goal.x_axis)


def rodrigues(axis: Float[Array, "3"], angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Rotation about a unit axis, Eq. 14: I + sin(lambda psi) A + (1 - cos(lambda psi)) A^2."""
    skew = jnp.cross(axis, jnp.eye(3, dtype=axis.dtype)).T
    return jnp.eye(3, dtype=axis.dtype) + jnp.sin(angle) * skew + (1.0 - jnp.cos(angle)) * skew @ skew


def turn_about_goal(arm: VirtualArm, goal: Goal, angle: Float[Array, ""]) -> VirtualArm:
    """The whole arm turned about Z_d through P_d, Eq. 15; its directions turn along."""
    rotation = rodrigues(goal.z_axis, angle)
    turned = lambda points: goal.position + (points - goal.position) @ rotation.T  # noqa: E731
    return dataclasses.replace(
        arm,
        bases=turned(arm.bases),
        joints=turned(arm.joints),
        ends=turned(arm.ends),
        base_directions=arm.base_directions @ rotation.T,
        end_directions=arm.end_directions @ rotation.T,
    )


def _is_going(config: FabrikConfig, state: Progress, limit) -> Any:
    """One that turns back where it stalls does not give up for it."""
    is_open = (state.turns < limit) & ~state.is_near
    return is_open & ~state.has_stalled if config.reversal == 0.0 else is_open


def _begin(robot: QuaternionArm, config: FabrikConfig, bends: jax.Array) -> Progress:
    none, zero = jnp.zeros((), bool), jnp.zeros((), jnp.int32)
    relaxation = jnp.asarray(config.relaxation, bends.dtype)
    arm = virtual_arm(robot, bends)
    return Progress(arm, relaxation, jnp.full_like(relaxation, jnp.inf), arm.joints, zero, zero, none, none)


def _iterate(robot: QuaternionArm, config: FabrikConfig, goal: Goal, state: Progress) -> Progress:
    """One outer iteration: reach the goal's position and direction, then turn by lambda psi what is not yet there."""
    arm, steps = reach(robot, state.arm, goal, _MARGIN * config.position_tolerance, config.inner_iterations)
    roll = roll_error(robot, arm, goal)
    is_near = (tip_distance(arm, goal) <= _MARGIN * config.position_tolerance) & (
        jnp.abs(roll) <= _MARGIN * config.orientation_tolerance
    )
    state = _look(config, state, arm, jnp.abs(roll))
    turned = turn_about_goal(arm, goal, state.relaxation * roll)
    return dataclasses.replace(
        state,
        arm=jax.tree.map(lambda ends, goes_on: jnp.where(is_near, ends, goes_on), arm, turned),
        turns=state.turns + 1,
        steps=state.steps + steps,
        is_near=is_near,
    )


def _look(config: FabrikConfig, state: Progress, arm: VirtualArm, roll: jax.Array) -> Progress:
    """Every `patience` turns: has it stalled, and does it turn the wrong way?"""
    is_time = (state.turns + 1) % config.patience == 0
    is_reversed = is_time & (roll > (1.0 - config.reversal) * state.roll_before) & (config.reversal > 0.0)
    moved = jnp.max(jnp.abs(arm.joints - state.joints_before))
    return dataclasses.replace(
        state,
        relaxation=jnp.where(is_reversed, -state.relaxation, state.relaxation),
        roll_before=jnp.where(is_time, roll, state.roll_before),
        joints_before=jnp.where(is_time, arm.joints, state.joints_before),
        has_stalled=jnp.where(is_time, moved < _STALLED * config.position_tolerance, state.has_stalled),
    )


@functools.partial(jax.jit, static_argnums=0)
def _begin_rows(config: FabrikConfig, robot: QuaternionArm, bends: jax.Array) -> Progress:
    return jax.vmap(lambda start: _begin(robot, config, start))(bends)


@functools.partial(jax.jit, static_argnums=0)
def _advance_rows(config: FabrikConfig, robot: QuaternionArm, limit, targets: jax.Array, states: Progress) -> Progress:
    return jax.vmap(lambda target, state: advance_one(robot, config, limit, target, state))(targets, states)


@functools.partial(jax.jit, static_argnums=0)
def _evaluate_rows(config: FabrikConfig, robot: QuaternionArm, targets: jax.Array, ends: Progress) -> SolveResult:
    states = jax.vmap(lambda end, target: _anchored_state(robot, end, target))(ends, targets)
    lengths = jax.vmap(lambda row: cable_lengths(robot, row))(states)
    tolerances = (config.position_tolerance, config.orientation_tolerance)
    result = describe_solution(robot, ClosedForm(robot), targets, lengths, tolerances, ends.steps)
    has_stalled = (result.status == Status.ITERATION_LIMIT) & ends.has_stalled
    return dataclasses.replace(result, status=jnp.where(has_stalled, int(Status.STALLED), result.status))


def _anchored_state(robot: QuaternionArm, end: Progress, target: jax.Array) -> jax.Array:
    """Bends of the end; where it was just turned once more, the arm is put back on its base by one more reach."""
    goal = goal_of(target)
    anchored, _ = reach(robot, end.arm, goal, 0.0, 1)
    return state_of(robot, jax.tree.map(lambda a, b: jnp.where(end.is_near, a, b), end.arm, anchored))


# Errors must be this part of the tolerances inside, so that the answer holds when it is recomputed.
_MARGIN = 0.9
# An arm that moves less than this part of the tolerance in `patience` outer iterations never gets there.
_STALLED = 0.01
# Turns after which batches are filled up anew for the first time.
_FIRST_LOOK = 25
