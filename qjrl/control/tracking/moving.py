"""While a trajectory is played: which strands went slack or reached their strength, and which motors were exceeded, and when."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from qjrl.control.tension_check import bearer_name
from qjrl.control.tracking.playing import Played
from qjrl.robot.verbs import Robot, is_at_strength
from qjrl.simulation.settling import SLACK_TENSION

Kind = Literal["strength", "motor", "slack"]
KINDS: tuple[Kind, ...] = ("strength", "motor", "slack")
"""What can be wrong, the gravest first."""


@dataclasses.dataclass(frozen=True)
class MovingBreach:
    """One strand or motor beyond its bound at some time."""

    kind: Kind
    name: str
    """Of the strand or cable."""
    first_s: float
    """When it first was [s since the plan's begin]."""
    worst_s: float
    """When it was worst [s]."""
    total_s: float
    """How long in all [s]."""
    value_newton: float
    """Tension or motor force at the worst [N]."""
    bound_newton: float
    """What it was to keep to [N]."""

    def __str__(self) -> str:
        """One clause of a sentence."""
        when = f"at {self.worst_s:.2f} s, for {self.total_s:.3f} s in all"
        if self.kind == "slack":
            return f"{self.name} goes slack {when}"
        bearer = "its strength" if self.kind == "strength" else "its motor's"
        return f"{self.name} needs {abs(self.value_newton):.0f} N {when} ({bearer} {self.bound_newton:g} N)"


def moving_breaches(robot: Robot, played: Played) -> list[MovingBreach]:
    """Every strand and motor that did not keep to its bounds, the gravest kind first, of a kind the longest first.

    All times count that were recorded: from the first command to a little after the plan's end.
    """
    config, tension, force = robot.config, played.strand_tension, np.abs(played.motor_force)
    excess = {
        "strength": (is_at_strength(robot, tension), tension, tension, config.strands.strength),
        "motor": (force > config.motors.force, force, played.motor_force, config.motors.force),
        "slack": (tension < SLACK_TENSION, -tension, tension, SLACK_TENSION),
    }
    found = []
    for kind in KINDS:
        is_beyond, severity, values, bound = excess[kind]
        of_kind = []
        for column in np.flatnonzero(is_beyond.any(axis=0)):
            name, beyond = bearer_name(robot, kind, int(column)), is_beyond[:, column]
            worst = int(np.argmax(np.where(beyond, severity[:, column], -np.inf)))
            first, total = played.time[np.argmax(beyond)], beyond.sum() * (played.time[1] - played.time[0])
            seconds = (float(first), float(played.time[worst]), float(total))
            of_kind.append(MovingBreach(kind, name, *seconds, float(values[worst, column]), float(bound)))
        found += sorted(of_kind, key=lambda breach: -breach.total_s)
    return found


def moving_message(breaches: Sequence[MovingBreach]) -> str:
    """One line: what is wrong, when and by how much, the longest of every kind named; empty where all is well."""
    clauses = []
    for kind in KINDS:
        of_kind = [breach for breach in breaches if breach.kind == kind]
        if of_kind:
            more = f" (and {len(of_kind) - 1} more)" if len(of_kind) > 1 else ""
            clauses.append(f"{of_kind[0]}{more}")
    return "; ".join(clauses)
