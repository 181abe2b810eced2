"""Does an exported controller command what the package's does, over whole episodes? Asked before a file is written."""

import dataclasses
import time
from typing import Any

import numpy as np

from qjrl.deployment.controller import NEXT, READING, DeployedController
from qjrl.deployment.parity import LoadedFunction, ParityError


@dataclasses.dataclass(frozen=True)
class Rehearsal:
    """What the package's own controller, in double precision, read and commanded in the simulation."""

    target: np.ndarray
    """(n, 9)."""
    base_lengths: np.ndarray
    """(n, num_cables) [m]."""
    reading: np.ndarray
    """(n, steps, segments, 2) [rad]."""
    command: np.ndarray
    """(n, steps, num_cables) [m]."""


class FileController:
    """A controller as a caller of the files runs it: a few arrays carried from call to call.

    Args:
        begin: the file of `begin_target`.
        step: the file of `control_step`.
        is_batched: whether arrays have a leading batch axis, of size 1 here.
    """

    def __init__(
        self,
        deployed: DeployedController,
        begin: LoadedFunction,
        step: LoadedFunction,
        precision: str,
        is_batched: bool,
    ):
        self._deployed, self._begin, self._step = deployed, begin, step
        self._precision, self._is_batched = precision, is_batched
        self._order = [port.name for port in deployed.step.inputs]
        self._state: dict[str, Any] = {}

    def begin(self, target: np.ndarray, base_lengths: np.ndarray, reading: np.ndarray) -> None:
        """A new target (9,), its base command (num_cables,) [m] and the first reading (segments, 2) [rad]."""
        fixed = {"target": self._given(target), "base_lengths": self._given(base_lengths)}
        self._state = fixed | dict(self._begin(fixed["target"], fixed["base_lengths"], self._given(reading)))

    def step(self, reading: np.ndarray) -> np.ndarray:
        """The next command (num_cables,) [m]; a command that is not finite leaves the state as it was."""
        arrays = self._state | {READING: self._given(reading)}
        answer = self._step(*(arrays[name] for name in self._order))
        command = np.asarray(answer[f"{NEXT}command"])
        if np.isfinite(command).all():
            self._state |= {name: answer[NEXT + name] for name in self._deployed.carried}
        return command[0] if self._is_batched else command

    def _given(self, array: Any) -> np.ndarray:
        given = np.asarray(array, self._precision)
        return given[None] if self._is_batched else given


def check_controller(file: str, controller: FileController, rehearsal: Rehearsal, tolerance: float) -> dict[str, float]:
    """Largest difference of the file's commands from the package's, given the same readings [m], and what a step takes.

    Raises:
        ParityError: it is beyond the tolerance, or a command is not finite.
    """
    largest, seconds = 0.0, []
    for row, target in enumerate(rehearsal.target):
        controller.begin(target, rehearsal.base_lengths[row], rehearsal.reading[row, 0])
        for reading, expected in zip(rehearsal.reading[row], rehearsal.command[row], strict=True):
            start = time.perf_counter()
            command = controller.step(reading)
            seconds.append(time.perf_counter() - start)
            difference = float(np.max(np.abs(command - expected)))
            if not difference <= tolerance:  # a NaN is not
                raise ParityError(
                    f"{file}: commands differ by {difference:.3g} m, allowed: {tolerance:.3g}; nothing was written"
                )
            largest = max(largest, difference)
    episodes, steps = rehearsal.command.shape[:2]
    median_ms = 1e3 * float(np.median(seconds))
    return {"episodes": episodes, "steps": steps, "command_difference": largest, "step_median_ms": median_ms}
