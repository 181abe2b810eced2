"""What a controller does with readings that cannot be trusted: hold the last command, flag it, go on when good ones come."""

import math
from typing import Any, Protocol

import numpy as np

from qjrl.robot.interface import ANGLE_MARGIN, ReadingLimits
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot

FLAGS = ("good", "stale", "not_finite", "bad_answer", "beyond_stop", "too_fast")
"""Names of the flags 0, 1, ...: a reading that was used; one too old; one not finite; an answer that was not finite; a
reading past a joint's stop; one further from the last good one than the motors can move a joint."""
GOOD, STALE, NOT_FINITE, BAD_ANSWER, BEYOND_STOP, TOO_FAST = range(len(FLAGS))
ASKED = (GOOD, BAD_ANSWER)
"""Flags of periods in which the controller was asked."""

NO_STOP_IS_BEYOND = ReadingLimits(math.pi / 2.0 + ANGLE_MARGIN, math.inf, math.inf)
"""Of an arm of which nothing is known: no description has a stop at 90 degrees or beyond."""
UNLIMITED = ReadingLimits(math.inf, math.inf, math.inf)
"""Of records made before there were limits."""


def reading_limits(robot: Robot) -> ReadingLimits:
    """What the readings of a robot's encoders keep to."""
    return verb(robot, "interface").reading_limits(robot)


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
