"""What a controller does with readings that cannot be trusted: hold the last command, flag it, go on when good ones come."""

import dataclasses
import itertools
import math
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.robot.verbs import Robot, bends_from_cables

FLAGS = ("good", "stale", "not_finite", "bad_answer", "beyond_stop", "too_fast")
"""Names of the flags 0, 1, ...: a reading that was used; one too old; one not finite; an answer that was not finite; a
reading past a joint's stop; one further from the last good one than the motors can move a joint."""
GOOD, STALE, NOT_FINITE, BAD_ANSWER, BEYOND_STOP, TOO_FAST = range(len(FLAGS))
ASKED = (GOOD, BAD_ANSWER)
"""Flags of periods in which the controller was asked."""

# Noise of the encoders and give of the stops [rad].
_ANGLE_MARGIN = math.radians(6.0)
# A joint springs and swings, which the motors do not.
_SPEED_FACTOR = 3.0


@dataclasses.dataclass(frozen=True)
class ReadingLimits:
    """What a reading of a sound encoder keeps to, in every segment."""

    angle: float
    """Largest bend of a joint [rad]."""
    speed: float
    """Largest rate of a joint's bend [rad/s]."""
    jump: float
    """What two readings may differ by besides, however short the time between them [rad]."""


NO_STOP_IS_BEYOND = ReadingLimits(math.pi / 2.0 + _ANGLE_MARGIN, math.inf, math.inf)
"""Of an arm of which nothing is known: no description has a stop at 90 degrees or beyond."""
UNLIMITED = ReadingLimits(math.inf, math.inf, math.inf)
"""Of records made before there were limits."""


def reading_limits(robot: Robot) -> ReadingLimits:
    """The stop of the robot's joints, and the rate at which its motors, all at their speed, can bend one at that stop."""
    joint = robot.config.joint
    stop = math.radians(joint.bend_limit_deg + joint.stop_margin_deg)
    by_length = np.asarray(jax.jacfwd(lambda row: bends_from_cables(robot, row))(jnp.zeros(robot.num_cables)))
    fastest = max(_fastest(rows) for rows in by_length) * float(robot.motor_speed)
    # theta = 2 asin|a|: at the stop it changes most with a
    speed = 2.0 * fastest / math.cos(stop / 2.0)
    return ReadingLimits(stop + _ANGLE_MARGIN, _SPEED_FACTOR * speed, _ANGLE_MARGIN)


def _fastest(rows: np.ndarray) -> float:
    """Largest length of rows (2, cables) times cable speeds of -1 or 1: at a corner of their cube, as the length is convex."""
    moved = rows[:, np.abs(rows).max(axis=0) > 0.0]
    return max(float(np.linalg.norm(moved @ signs)) for signs in itertools.product((-1.0, 1.0), repeat=moved.shape[1]))


class Controller(Protocol):
    """A controller of one arm."""

    def begin(self, target: np.ndarray, base_lengths: np.ndarray, reading: np.ndarray) -> None:
        """A new target (9,), its base command (num_cables,) [m] and the first reading (segments, 2) [rad]."""
        ...

    def step(self, reading: np.ndarray) -> np.ndarray:
        """The next command (num_cables,) [m]; one that is not finite must leave the state as it was."""
        ...


class SafeController:
    """A controller that stands still, clock and all, while its readings are bad; it begins with the first good one.

    Held is the last command, home before the first: a brake, not a plan. The ramp, the dither and the means go on where
    they stood, so that no command jumps; what the arm did meanwhile shows in the next reading.

    Args:
        largest_age: an older reading is stale [s].
        limits: of the arm's readings, see `reading_limits`.
        period: control period [s], at which `step` is called; without one, speed is not evaluated.
    """

    def __init__(
        self,
        controller: Controller,
        largest_age: float,
        limits: ReadingLimits = NO_STOP_IS_BEYOND,
        period: float = math.inf,
    ):
        self._controller, self._largest_age = controller, largest_age
        self.limits, self._period = limits, period
        self._task: tuple[np.ndarray, np.ndarray] | None = None

    def with_limits(self, limits: ReadingLimits, period: float) -> "SafeController":
        """The same controller, its readings held against other limits."""
        return SafeController(self._controller, self._largest_age, limits, period)

    def begin(self, target: np.ndarray, base_lengths: np.ndarray) -> None:
        """A new target (9,) and its base command (num_cables,) [m]; the arm is at home."""
        self._task = (target, base_lengths)
        self._command = np.zeros_like(base_lengths)
        self._last: Any = None
        self._periods_since = 0

    def step(self, reading: np.ndarray, age: float) -> tuple[np.ndarray, int]:
        """The command (num_cables,) [m] of this period, and why it is what it is.

        Args:
            reading: (segments, 2) [rad].
            age: since it was taken [s].
        """
        self._periods_since += 1
        flag = self._evaluate(reading, age)
        if flag == GOOD:
            self._last, self._periods_since = np.array(reading, np.float64), 0
            if self._task is not None:
                self._controller.begin(*self._task, reading)
                self._task = None
            command = self._controller.step(reading)
            flag = GOOD if np.isfinite(command).all() else BAD_ANSWER
            self._command = command if flag == GOOD else self._command
        return self._command, flag

    def _evaluate(self, reading: np.ndarray, age: float) -> int:
        if not age <= self._largest_age:  # a NaN is not
            return STALE
        if not np.isfinite(reading).all():
            return NOT_FINITE
        if _largest(reading) > self.limits.angle:
            return BEYOND_STOP
        if self._last is not None and _largest(reading - self._last) > self._reachable():
            return TOO_FAST
        return GOOD

    def _reachable(self) -> float:
        """What a joint can have moved since the last good reading [rad]: the longer ago that was, the more."""
        time = self._periods_since * self._period
        return math.inf if math.isinf(time) else self.limits.jump + self.limits.speed * time


def _largest(vectors: np.ndarray) -> float:
    """Largest bend of rotation vectors (segments, 2) [rad], whatever their size."""
    return float(np.max(np.hypot(*np.asarray(vectors, np.float64).T)))
