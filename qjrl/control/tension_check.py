"""Before a path or pose is played: which rows would slacken a strand, exceed a motor or a strand's strength, or not rest."""

import dataclasses
from typing import Literal

import numpy as np

from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot, is_at_strength
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SettleResult, settle

Kind = Literal["unsettled", "strength", "motor", "slack"]
KINDS: tuple[Kind, ...] = ("unsettled", "strength", "motor", "slack")
"""What can be wrong with a row, the gravest first."""


@dataclasses.dataclass(frozen=True)
class Breach:
    """The worst row of one kind."""

    kind: Kind
    row: int
    """Of the commands, counted from 0."""
    name: str
    """Of the strand or cable; empty for a row that does not settle."""
    value: float
    """Tension or motor force [N]; of an unsettled row its mean |joint velocity| [rad/s]."""
    bound: float
    """What the value was to keep to [N]; NaN for an unsettled row."""
    num_rows: int
    """Rows with a breach of this kind."""

    def __str__(self) -> str:
        """One clause of a sentence."""
        if self.kind == "unsettled":
            return f"row {self.row} does not come to rest ({self.value:.2g} rad/s left)"
        if self.kind == "slack":
            return f"{self.name} falls to {self.value:.1f} N at row {self.row} (at least {self.bound:g} N asked)"
        bearer = "its strength" if self.kind == "strength" else "its motor's"
        return f"{self.name} needs {abs(self.value):.0f} N at row {self.row} ({bearer} {self.bound:g} N)"


@dataclasses.dataclass(frozen=True)
class TensionCheck:
    """Commands settled in the physics and held against the robot's bounds."""

    robot: Robot
    rest: SettleResult
    least_tension: float
    """What every strand is to keep [N]."""

    @property
    def is_unsettled(self) -> np.ndarray:
        """(n,) whether a row does not come to rest; its other values count for nothing."""
        return ~self.rest.converged

    @property
    def is_slack(self) -> np.ndarray:
        """(n, strands) whether a strand carries less than asked."""
        return (self.rest.strand_tension < self.least_tension) & self.rest.converged[:, None]

    @property
    def exceeds_motor(self) -> np.ndarray:
        """(n, cables) whether a motor would have to hold more than it can; the physics lets it."""
        return (np.abs(self.rest.motor_force) > self.robot.config.motors.force) & self.rest.converged[:, None]

    @property
    def exceeds_strength(self) -> np.ndarray:
        """(n, strands) whether a strand breaks."""
        return is_at_strength(self.robot, self.rest.strand_tension) & self.rest.converged[:, None]

    @property
    def is_safe(self) -> np.ndarray:
        """(n,) whether nothing is wrong with a row."""
        wrong = (self.is_slack, self.exceeds_motor, self.exceeds_strength)
        return self.rest.converged & ~np.any([rows.any(axis=1) for rows in wrong], axis=0)

    @property
    def breaches(self) -> list[Breach]:
        """The worst row of every kind that occurs, the gravest kind first."""
        return [breach for kind in KINDS if (breach := self._worst(kind)) is not None]

    @property
    def message(self) -> str:
        """One line: what is wrong, where and by how much; empty where all is well."""
        if not (breaches := self.breaches):
            return ""
        count, clauses = int(np.sum(~self.is_safe)), "; ".join(map(str, breaches))
        return f"{count} of {len(self.is_safe)} rows are not safe to play: {clauses}"

    def _worst(self, kind: Kind) -> Breach | None:
        config, rest = self.robot.config, self.rest
        has_breach, severity, values, bound = {
            "unsettled": (self.is_unsettled[:, None], rest.speed[:, None], rest.speed[:, None], np.nan),
            "strength": (self.exceeds_strength, rest.strand_tension, rest.strand_tension, config.strands.strength),
            "motor": (self.exceeds_motor, np.abs(rest.motor_force), rest.motor_force, config.motors.force),
            "slack": (self.is_slack, -rest.strand_tension, rest.strand_tension, self.least_tension),
        }[kind]
        if not has_breach.any():
            return None
        worst = int(np.argmax(np.where(has_breach, np.where(np.isnan(severity), np.inf, severity), -np.inf)))
        row, column = np.unravel_index(worst, has_breach.shape)
        num_rows = int(has_breach.any(axis=1).sum())
        name = bearer_name(self.robot, kind, int(column))
        return Breach(kind, int(row), name, float(values[row, column]), float(bound), num_rows)


def check_tension(
    robot: Robot, cable_lengths, least_tension: float = 0.01, simulation: SettleConfig | None = None, advance=None
) -> TensionCheck:
    """Settle the arm at every row of a path or a set of poses and hold what the strands carry against the bounds.

    Args:
        robot: the arm; its motors' force and its strands' strength are the bounds.
        cable_lengths: (n, num_cables) [m] relative to home, + pays out.
        least_tension: what every strand is to keep [N].
        advance: called with the number of newly settled rows.
    Raises:
        ValueError: as `settle`.
    """
    return TensionCheck(robot, settle(robot, cable_lengths, config=simulation, advance=advance), least_tension)


def bearer_name(robot: Robot, kind: Kind, column: int) -> str:
    """Of the strand or cable in a column of what is checked; a row that does not settle has none."""
    if kind == "unsettled":
        return ""
    if kind == "motor":
        return verb(robot, "cable_names")(robot)[column]
    return verb(robot, "strand_names")(robot)[column]
