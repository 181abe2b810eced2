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

from qjrl.config import ConfigError
from qjrl.deployment.line import Line
from qjrl.deployment.safety import SafeController
from qjrl.simulation.control_period import substeps_of

_SPIN = 0.0005
"""The clock is watched without sleeping for this long before a period begins [s]: sleep oversleeps."""


_PRIORITY = 10
"""Among real-time processes: below what the system itself runs."""


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
class Clock:
    """What the loop keeps to."""

    now: Callable[[], float] = time.perf_counter
    """[s]."""
    sleep: Callable[[float], None] = time.sleep


@dataclasses.dataclass(frozen=True)
class Schedule:
    """When the controller is asked."""

    num_periods: int
    """Of an episode."""
    period: float
    """[s]."""
    clock: Clock = Clock()


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
    task: tuple[np.ndarray, np.ndarray],
    schedule: Schedule,
    line: Line,
    show: Callable[[Plant], None] | None = None,
) -> Played:
    """One episode: the arm is at home and reaches for a target.

    Args:
        task: the target's pose (9,) and its base command (num_cables,) [m].
        show: called in every period after the command, for a viewer.
    """
    controller.begin(*task)
    clock, period = schedule.clock, schedule.period
    substeps, number, lost = substeps_of(period, plant.timestep), 0, 0
    rows: list[tuple] = []
    begin = clock.now() + period
    while number < schedule.num_periods:
        due = begin + number * period
        _wait_until(clock, due)
        now, pose, positions = clock.now(), plant.pose, plant.joint_positions
        reading, stamp = line.receive(number, plant.read(), now)
        asked = clock.now()
        command, flag = controller.step(reading, now - stamp)
        latency = clock.now() - asked
        rows.append((number, now - due, latency, now - stamp, reading, flag, command, pose, positions))
        left = substeps * (schedule.num_periods - number)
        late = min(int((now - due + latency) / plant.timestep), left)
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
def on_one_core(has_priority: bool = False) -> Iterator[int | None]:
    """All threads of this process share one core, and no garbage is collected; yields the core, None where unknown.

    Args:
        has_priority: ask the system to let them go before all that is not real-time (SCHED_FIFO).
    Raises:
        ConfigError: it does not let us.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    allowed = os.sched_getaffinity(0)
    core = min(allowed)
    gc.collect()
    gc.disable()
    try:
        _for_all_threads(lambda thread: os.sched_setaffinity(thread, {core}))
        if has_priority:
            _go_before_others()
        yield core
    finally:
        if has_priority:
            _for_all_threads(lambda thread: os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0)))
        _for_all_threads(lambda thread: os.sched_setaffinity(thread, allowed))
        gc.enable()


def _go_before_others() -> None:
    try:
        _for_all_threads(lambda thread: os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(_PRIORITY)))
    except PermissionError as error:
        raise ConfigError(
            "deploy.has_priority: got true, allowed: only with the right to real-time scheduling (root, ulimit -r)"
        ) from error


def _for_all_threads(apply: Callable[[int], None]) -> None:
    for thread in Path("/proc/self/task").iterdir():
        try:
            apply(int(thread.name))
        except ProcessLookupError:  # it has ended
            continue


def _wait_until(clock: Clock, moment: float) -> None:
    while (left := moment - clock.now()) > 0.0:
        if left > _SPIN:
            clock.sleep(left - _SPIN)
