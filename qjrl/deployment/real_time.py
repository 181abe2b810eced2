"""The control loop in real time: every period a reading, a command by its deadline, and the physics in what is left.

The physics keeps to the same clock: a command that comes late reaches the motors late, and periods that have gone by
meanwhile are lost. Everything runs on one core, the controller's share of it is measured.
"""

import dataclasses
import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np

from qjrl.deployment.line import Line
from qjrl.deployment.safety import SafeController

_SPIN = 0.0005
"""The clock is watched without sleeping for this long before a period begins [s]: sleep oversleeps."""


class Plant(Protocol):
    """The arm: real or simulated."""

    timestep: float

    def read(self) -> np.ndarray:
        """The encoders' estimate (segments, 2) [rad] now."""
        ...

    def hold(self, lengths: np.ndarray) -> None:
        """Give the motors cable lengths (num_cables,) [m]."""
        ...

    def advance(self, num_steps: int) -> None:
        """Let so many time steps pass; a real arm needs no help."""
        ...

    @property
    def pose(self) -> np.ndarray:
        """(9,) of the tip: for the record, no controller sees it."""
        ...

    @property
    def joint_positions(self) -> np.ndarray:
        """(nq,) for the record."""
        ...


@dataclasses.dataclass(frozen=True)
class Played:
    """The record of one episode, a row for every period in which the controller was asked; times since its begin."""

    period: np.ndarray
    """(n,) which period of the clock."""
    lateness: np.ndarray
    """(n,) by how much the row began after its period [s]."""
    latency: np.ndarray
    """(n,) from the reading to the command [s]."""
    age: np.ndarray
    """(n,) of the reading when it was used [s]."""
    reading: np.ndarray
    """(n, segments, 2) [rad]."""
    flag: np.ndarray
    """(n,) index into `safety.FLAGS`."""
    command: np.ndarray
    """(n, num_cables) [m]."""
    pose: np.ndarray
    """(n, 9) of the tip when the reading was taken."""
    joint_positions: np.ndarray
    """(n, nq) then."""
    lost_periods: np.ndarray
    """() periods that went by without a command."""


def play(
    controller: SafeController,
    plant: Plant,
    target: np.ndarray,
    base_lengths: np.ndarray,
    num_periods: int,
    period: float,
    line: Line,
    show: Callable[[Plant], None] | None = None,
) -> Played:
    """One episode: the arm is at home and reaches for a target (9,) with the base command (num_cables,) [m].

    Args:
        show: called in every period after the command, for a viewer.
    """
    rows: list[tuple] = []
    controller.begin(target, base_lengths)
    substeps = round(period / plant.timestep)
    number, lost = 0, 0
    begin = time.perf_counter() + period
    while number < num_periods:
        due = begin + number * period
        _wait_until(due)
        now = time.perf_counter()
        record = (plant.pose, plant.joint_positions)
        reading, stamp = line.receive(number, plant.read(), now)
        asked = time.perf_counter()
        age = now - stamp
        command, flag = controller.step(reading, age)
        latency = time.perf_counter() - asked
        rows.append((number, now - due, latency, age, reading, flag, command, *record))
        late = min(int((now - due + latency) / plant.timestep), substeps * (num_periods - number))
        plant.advance(late)  # with the command of before
        plant.hold(command)
        plant.advance(-late % substeps if late else substeps)
        passed = max(1, -(-late // substeps))
        lost, number = lost + passed - 1, number + passed
        if show:
            show(plant)
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return Played(*columns, lost_periods=np.array(lost))


@contextmanager
def on_one_core() -> Iterator[int | None]:
    """All threads of this process share one core, and no garbage is collected; yields the core, None where unknown."""
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    allowed = os.sched_getaffinity(0)
    core = min(allowed)
    gc.collect()
    gc.disable()
    try:
        _bind_threads({core})
        yield core
    finally:
        _bind_threads(allowed)
        gc.enable()


def _bind_threads(cores: set[int]) -> None:
    for thread in Path("/proc/self/task").iterdir():
        try:
            os.sched_setaffinity(int(thread.name), cores)
        except ProcessLookupError:  # it has ended
            continue


def _wait_until(moment: float) -> None:
    while (left := moment - time.perf_counter()) > 0.0:
        if left > _SPIN:
            time.sleep(left - _SPIN)
