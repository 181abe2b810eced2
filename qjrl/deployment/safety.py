"""What a controller does with readings that cannot be trusted: hold the last command, flag it, go on when good ones come."""

from typing import Protocol

import numpy as np

FLAGS = ("good", "stale", "not_finite", "bad_answer")
"""Names of the flags 0, 1, 2, 3: a reading that was used; one too old; one not finite; an answer that was not finite."""
GOOD, STALE, NOT_FINITE, BAD_ANSWER = range(len(FLAGS))
ASKED = (GOOD, BAD_ANSWER)
"""Flags of periods in which the controller was asked."""


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
    """

    def __init__(self, controller: Controller, largest_age: float):
        self._controller, self._largest_age = controller, largest_age

    def begin(self, target: np.ndarray, base_lengths: np.ndarray) -> None:
        """A new target (9,) and its base command (num_cables,) [m]; the arm is at home."""
        self._task: tuple[np.ndarray, np.ndarray] | None = (target, base_lengths)
        self._command = np.zeros_like(base_lengths)

    def step(self, reading: np.ndarray, age: float) -> tuple[np.ndarray, int]:
        """The command (num_cables,) [m] of this period, and why it is what it is.

        Args:
            reading: (segments, 2) [rad].
            age: since it was taken [s].
        """
        flag = self._judge(reading, age)
        if flag == GOOD:
            if self._task is not None:
                self._controller.begin(*self._task, reading)
                self._task = None
            command = self._controller.step(reading)
            flag = GOOD if np.isfinite(command).all() else BAD_ANSWER
            self._command = command if flag == GOOD else self._command
        return self._command, flag

    def _judge(self, reading: np.ndarray, age: float) -> int:
        if not age <= self._largest_age:  # a NaN is not
            return STALE
        return GOOD if np.isfinite(reading).all() else NOT_FINITE
