"""Inverse kinematics for control loops: one target at a time, from where the arm is, at a fixed cost.

A call is one compiled program: damped least squares of a fixed number of steps, each as `levenberg_marquardt` takes them.
The answer stays within a ball about the start, so that it is no other branch. An arm with more coordinates than a pose has
also moves a little towards home where that leaves the tip in place: noise of the measured joints does not add up.
"""

import math
from functools import partial
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.config import Range, configuration
from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot.forward_model import PoseFunction
from qjrl.robot.ik_result import check_targets
from qjrl.robot.kinds import configuration_shape, kind_of, verb
from qjrl.robot.limits import Limits
from qjrl.robot.plausibility import FARTHEST_TARGET, one_configuration, one_sample
from qjrl.robot.tip import Tip
from qjrl.robot.verbs import Robot, cable_lengths, home
from qjrl.solvers.levenberg_marquardt import DescentConfig, Residual, damped_step, free_jacobian, residual_of
from qjrl.solvers.model_tip import TipFunction, tip_function


@configuration
class FollowConfig:
    """Settings of a `PoseFollower`; all values ours."""

    descent: DescentConfig = DescentConfig(damping=1e-4, damping_increase=10.0)
    """Weights, damping, tolerances. A call begins with little damping, next to its answer, and must find enough in a few
    steps where the target is out of reach. It does not end early: `shortest_step` and `optimality` play no part."""
    iterations: Annotated[int, Range(1, 1000)] = 8
    """Steps of every call, no more and no fewer."""
    largest_move: Annotated[float, Range(above=0.0)] = 0.2
    """Bound of a call's motion from its start, over all coordinates [rad]."""
    posture: Annotated[float, Range(low=0.0, high=1.0)] = 0.01
    """Share of the way home that a call moves, in what motion leaves the tip in place; 0: none."""


class NextPose(NamedTuple):
    """Answer to one target; NumPy, in the robot's precision."""

    configuration: np.ndarray
    """Of the robot's kind, such as bends (num_segments, 2)."""
    cable_lengths: np.ndarray
    """(num_cables,) [m] relative to home, + pays out."""
    position_error: float
    """[m], predicted by the model that was asked."""
    orientation_error: float
    """[rad], predicted."""
    converged: bool
    """Whether both errors are within their tolerances."""


class PoseFollower:
    """Follows targets one at a time, compiled when it is made.

    Not converged is no failure: a target out of reach, or farther away than `largest_move`, gets the answer of least
    weighted squared error that the steps find, and the next call goes on from there.
    """

    def __init__(self, robot: Robot, model: PoseFunction | None = None, config: FollowConfig = FollowConfig()):
        """Compile for one robot and model.

        Args:
            robot: its precision is that of the computation, see `in_precision`.
            model: lengths (num_cables,) [m] -> pose (9,), near the nominal closed form, which is the default.
            config: steps, bounds, tolerances.
        Raises:
            ConfigError: it is no robot, or its kind lacks what is needed.
        """
        self._robot, self._shape, self._check = robot, configuration_shape(robot), kind_of(robot).check
        self._size, self._farthest = math.prod(self._shape), FARTHEST_TARGET * float(verb(robot, "reach")(robot))
        self._dtype = np.dtype(jnp.result_type(*jax.tree.leaves(robot)))
        question = jax.ShapeDtypeStruct((9 + self._size,), self._dtype)
        self._program = jax.jit(partial(_answer, robot, model, config)).lower(question).compile()

    def solve(self, target: Any, start: Any) -> NextPose:
        """The configuration next to `start` whose pose under the model is that of the target, limits kept.

        NumPy arrays are taken as they are, which is quickest.

        Args:
            target: (9,) pose [m, -].
            start: configuration such as bends (num_segments, 2): of the measured joints, or the last answer's.
        Raises:
            ValueError: a target of the wrong shape, non-finite, no rotation or far away; a start of the wrong shape,
                non-finite, or that no robot of the kind can have.
        """
        question = np.concatenate((self._checked_target(target), self._checked_start(start).reshape(-1)))
        answer = np.array(self._program(question.astype(self._dtype, copy=False)))
        size, (position, orientation, is_near) = self._size, answer[-3:].tolist()
        return NextPose(answer[:size].reshape(self._shape), answer[size:-3], position, orientation, bool(is_near))

    def _checked_target(self, target: Any) -> np.ndarray:
        """The target as (9,); what fails this quick look is looked at again, for the message."""
        row = target if _is_plain(target, (9,)) else np.asarray(one_sample(target, (9,), "target"))
        x, y, z, a, b, c, d, e, f = row.tolist()
        off = max(abs(a * a + b * b + c * c - 1.0), abs(d * d + e * e + f * f - 1.0), abs(a * d + b * e + c * f))
        if not (off <= _ALLOWED_OFF and x * x + y * y + z * z <= self._farthest**2):  # NaN fails, too
            check_targets(self._robot, one_sample(row, (9,), "target")[None])
        return row

    def _checked_start(self, start: Any) -> np.ndarray:
        """The start in the configuration's shape."""
        if not _is_plain(start, self._shape) or not np.isfinite(start).all():
            return np.asarray(one_configuration(self._robot, start))
        if self._check is not None:
            self._check(self._robot, start[None], "configuration")
        return start


def _is_plain(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether it is an array of real numbers that can be taken as it is."""
    return type(value) is np.ndarray and value.dtype.kind == "f" and value.shape == shape


@struct.dataclass
class _Near:
    """Limits, and a ball about a start within them: bringing coordinates back within the limits moves them no farther
    from it, since discs and boxes are convex."""

    limits: Limits
    centre: jax.Array
    radius: float

    def within(self, coordinates: jax.Array) -> jax.Array:
        """Brought back within both."""
        move = coordinates - self.centre
        size = jnp.sqrt(jnp.sum(move**2, axis=0))
        return self.limits.within(self.centre + move * (self.radius / jnp.maximum(size, self.radius)))


@struct.dataclass
class _Search:
    """Where the steps have come to; one column a start."""

    trial: jax.Array  # coordinates to look at next
    coordinates: jax.Array  # the best so far
    pose: jax.Array  # (9, 1) of the tip there
    residual: Residual
    damping: jax.Array


def _answer(robot: Robot, model: PoseFunction | None, config: FollowConfig, question: jax.Array) -> jax.Array:
    """Configuration, cable lengths, position and orientation error, whether they are within the tolerances, in a row."""
    kind, target = kind_of(robot), question[:9]
    begun = kind.coordinates_of(robot, question[9:].reshape(configuration_shape(robot)))
    found = _search(robot, tip_function(model), config, target, begun[:, None])
    configuration = kind.configuration_of(robot, found.coordinates[:, 0])
    pose, tolerances = found.pose[:, 0], config.descent
    position, orientation = position_error(pose, target), orientation_error(pose, target)
    is_near = (position <= tolerances.position_tolerance) & (orientation <= tolerances.orientation_tolerance)
    errors = jnp.stack([position, orientation, is_near.astype(position.dtype)])
    return jnp.concatenate([configuration.reshape(-1), cable_lengths(robot, configuration), errors])


def _search(robot: Robot, tip: TipFunction, config: FollowConfig, target: jax.Array, begun: jax.Array) -> _Search:
    """Evaluates a trial, keeps it where it is nearer, and steps on from the nearest; one loop, so that the robot's
    kinematics are compiled once."""
    limits, descent = kind_of(robot).limits(robot), config.descent
    near = _Near(limits, limits.within(begun), config.largest_move)
    homewards = config.posture * (
        kind_of(robot).coordinates_of(robot, home(robot).astype(begun.dtype))[:, None] - near.centre
    )

    def advance(number: jax.Array, state: _Search) -> _Search:
        tip_there = tip(robot, state.trial)
        residual = residual_of(tip_there, descent.rotation_weight, target[:, None])
        allowed = jnp.where(number == 1, jnp.maximum(state.residual.cost, _COST_OF_POSTURE), state.residual.cost)
        is_better = residual.cost < allowed
        found = _Search(state.trial, state.trial, _pose_of(tip_there), residual, state.damping)
        found = jax.tree.map(partial(jnp.where, is_better), found, state)
        factor = jnp.where(is_better, descent.damping_decrease, descent.damping_increase)
        damping = jnp.where(number == 0, descent.damping, state.damping * factor)
        step = _step(limits, found, damping, jnp.where(number == 0, homewards, 0.0), descent.largest_step)
        return found.replace(trial=near.within(found.coordinates + step), damping=damping)

    size, dtype = len(begun), begun.dtype
    unknown = Residual(jnp.full((6, 1), jnp.inf, dtype), jnp.zeros((6, size, 1), dtype))
    state = _Search(near.centre, near.centre, jnp.zeros((9, 1), dtype), unknown, jnp.zeros(1, dtype))
    return jax.lax.fori_loop(0, config.iterations + 1, advance, state)


def _step(limits: Limits, state: _Search, damping: jax.Array, wished: jax.Array, largest: float) -> jax.Array:
    """The damped step that leaves `wished` least: all of it that the tip does not feel."""
    felt = jnp.sum(state.residual.jacobian * wished, axis=1)
    free = free_jacobian(limits, state.coordinates, state.residual)
    return wished + damped_step(Residual(state.residual.error - felt, free), damping, largest)


def _pose_of(tip: Tip) -> jax.Array:
    """(9, 1)."""
    return jnp.concatenate([tip.position, tip.rotation[:, 0], tip.rotation[:, 1]])


# Of a rotation's columns: what `check_targets` allows.
_ALLOWED_OFF = 1e-3
# Squared weighted error [m^2] that the move towards home may cost: the steps after it make up for a millimetre.
_COST_OF_POSTURE = 1e-6
