"""The deployment of a controller: a few targets in real time, then one of them again with faults on the line."""

import dataclasses
from collections.abc import Callable
from typing import Annotated, Protocol

import numpy as np

from qjrl.config import Range
from qjrl.deployment.controller_export import ControllerExportConfig
from qjrl.deployment.line import FaultConfig, Line, draw_faults
from qjrl.deployment.real_time import Plant, Played, on_one_core, play
from qjrl.deployment.safety import SafeController


@dataclasses.dataclass(frozen=True)
class DeployConfig:
    """Group `deploy`."""

    num_targets: Annotated[int, Range(1, 1000)] = 3
    """Held-out targets to reach for, each in one episode of real time; the first again with faults."""
    largest_age: Annotated[float, Range(above=0.0)] = 0.015
    """A reading older than this is stale [s]; less than a control period, so that a frame seen twice is."""
    accepted_latency: Annotated[float, Range(above=0.0)] = 0.002
    """99th percentile of the controller's latency that counts as good [s]."""
    files: ControllerExportConfig = ControllerExportConfig()
    faults: FaultConfig = FaultConfig()
    replay: str = ""
    """Record of an earlier deployment (its `log.npz`) to put through the controller again; nothing is played then."""
    view: bool = False
    """Show the arm in a browser, in MuJoCo's web viewer on 127.0.0.1, while it moves; costs time on the same core."""
    port: Annotated[int, Range(1024, 65535)] = 8080
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
    num_periods: int,
    period: float,
    config: DeployConfig,
    seed: int,
    show: Callable[[Plant], None] | None = None,
    advance: Callable[[int], None] | None = None,
) -> tuple[list[Played], np.ndarray]:
    """Every target in turn, on one core; the last episode is the first target with faults.

    Args:
        targets: poses (k, 9) and base commands (k, num_cables) [m].
        advance: called with the periods that were played.
    Returns:
        The episodes and which of them had faults.
    """
    rows = [*range(len(targets[0])), 0]
    has_faults = np.array([False] * len(targets[0]) + [True])
    episodes = []
    with on_one_core():
        for row, is_faulty in zip(rows, has_faults, strict=True):
            faults = draw_faults(config.faults, num_periods, seed) if is_faulty else np.zeros(num_periods, int)
            arm.home(row)
            played = play(controller, arm, targets[0][row], targets[1][row], num_periods, period, Line(faults), show)
            episodes.append(played)
            if advance:
                advance(num_periods)
    return episodes, has_faults
