"""The deployment of a controller: a few targets in real time, then one of them again with faults on the line."""

from collections.abc import Callable, Iterator
from typing import Annotated, Protocol

import numpy as np

from qjrl.config import NotIdentity, Range, configuration
from qjrl.deployment.controller_export import ControllerExportConfig
from qjrl.deployment.line import NO_FAULT, FaultConfig, Line, draw_faults
from qjrl.deployment.real_time import Plant, Played, Schedule, on_one_core, play
from qjrl.deployment.safety import SafeController


@configuration
class DeployConfig:
    """Group `deploy`; all values ours."""

    num_targets: Annotated[int, Range(1, 1000)] = 3
    """Held-out targets to reach for, each in one episode of real time; the first again with faults."""
    largest_age: Annotated[float, Range(above=0.0)] = 0.015
    """A reading older than this is stale [s]; less than a control period, so that a frame seen twice is."""
    accepted_latency: Annotated[float, Range(above=0.0)] = 0.002
    """99th percentile of the controller's latency that counts as good [s]."""
    has_priority: bool = False
    """Let the loop go before all processes that are not real-time (Linux, needs the right to), so that others cannot delay it."""
    files: ControllerExportConfig = ControllerExportConfig()
    faults: FaultConfig = FaultConfig()
    replay: str = ""
    """Record of an earlier deployment (its `log.npz`) to put through the controller again; nothing is played then."""
    view: bool = False
    """Show the arm in a browser, in MuJoCo's web viewer on 127.0.0.1, while it moves; costs time on the same core."""
    port: Annotated[int, Range(1024, 65535), NotIdentity()] = 8080
    """Of the viewer."""


class Homed(Plant, Protocol):
    """An arm that can be put back at home."""

    def home(self, number: int) -> None:
        """At rest at home, ready for episode `number`."""
        ...


def deploy(
    controller: SafeController,
    arm: Homed,
    targets: tuple[np.ndarray, np.ndarray],
    schedule: Schedule,
    config: DeployConfig,
    seed: int,
    show: Callable[[Plant], None] | None = None,
) -> Iterator[Played]:
    """Every target in turn, on one core, then the first one again with faults.

    Args:
        targets: poses (k, 9) and base commands (k, num_cables) [m].
        seed: of the faults.
    """
    tasks = list(zip(*targets, strict=True))
    sound = np.full(schedule.num_periods, NO_FAULT)
    faults = [sound] * len(tasks) + [draw_faults(config.faults, schedule.num_periods, seed)]
    rows = [*range(len(tasks)), 0]
    with on_one_core(config.has_priority):
        for row, of_episode in zip(rows, faults, strict=True):
            arm.home(row)
            yield play(controller, arm, tasks[row], schedule, Line(of_episode), show)
