"""Faults put on purpose into the line from the encoders to the controller."""

import dataclasses
from typing import Annotated

import numpy as np

from qjrl.config import Range, configuration

NO_FAULT, LOST, CORRUPT, ABSURD = range(4)
_ABSURD = 57.3
"""What an absurd reading is multiplied by, and has added [rad]: finite, as of degrees taken for radians."""


@configuration
class FaultConfig:
    """Keys of `deploy.faults`; they strike in one episode of their own. Values ours."""

    rate: Annotated[float, Range(0.0, 1.0)] = 0.02
    """Chance that a fault begins in a control period."""
    longest: Annotated[int, Range(1, 1000)] = 10
    """Control periods that a fault lasts at most; every length is as likely."""


def draw_faults(config: FaultConfig, steps: int, seed: int) -> np.ndarray:
    """(steps,) what happens to each reading: nothing, lost (the last one is seen again), corrupt (not a
    number), absurd (finite, but no arm's)."""
    rng, faults = np.random.default_rng(seed), np.full(steps, NO_FAULT)
    step = 1
    while step < steps:
        if rng.random() < config.rate:
            length = int(rng.integers(1, config.longest + 1))
            faults[step : step + length] = rng.choice([LOST, CORRUPT, ABSURD])
            step += length
        step += 1
    return faults


@dataclasses.dataclass
class Line:
    """The line with its faults: what the controller gets of a reading, and when that was taken."""

    faults: np.ndarray
    _last: tuple[np.ndarray, float] | None = None

    def receive(self, step: int, reading: np.ndarray, time: float) -> tuple[np.ndarray, float]:
        """Reading (segments, 2) [rad] and its time stamp [s] as they arrive in a control period."""
        fault = self.faults[step]
        if fault == LOST and self._last is not None:
            return self._last
        changed = {CORRUPT: np.full_like(reading, np.nan), ABSURD: _ABSURD * (1.0 + np.asarray(reading))}
        self._last = (changed.get(int(fault), reading), time)
        return self._last
