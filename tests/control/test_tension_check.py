"""What is named before a path is played, on made-up rests and on settled ones."""

import numpy as np
from arms import altered, arm_named, over_rows, random_bends

from qjrl.control.tension_check import TensionCheck, check_tension
from qjrl.robot import cable_lengths, robot_from_mapping
from qjrl.simulation.settling import SettleResult

ARM = arm_named("qj_22")


def rest(tension: np.ndarray, converged: np.ndarray | None = None) -> SettleResult:
    """A rest of which only what the check reads is filled in."""
    rows, nothing = len(tension), np.zeros((len(tension), 1))
    settled = np.ones(rows, bool) if converged is None else converged
    speed = np.where(settled, 0.0, 0.5)
    return SettleResult(ARM, nothing, nothing, tension, nothing, speed, speed, speed, settled)


def test_a_taut_arm_is_safe_and_nothing_is_said():
    check = TensionCheck(ARM, rest(np.full((3, 8), 15.0)), 2.0)
    assert check.is_safe.all() and check.breaches == [] and check.message == ""


def test_the_worst_strand_is_named_with_row_and_value():
    tension = np.full((4, 8), 15.0)
    tension[1, 3], tension[2, 5], tension[2, 6] = 1.5, 0.25, 1.0
    check = TensionCheck(ARM, rest(tension), 2.0)
    (breach,) = check.breaches
    names = ARM.config.cables.names
    assert (breach.kind, breach.row, breach.value, breach.num_rows) == ("slack", 2, 0.25, 2)
    assert breach.name == f"strand_{names[1][0]}_b"  # strand 5 is the second of cable 2, the second segment's first
    assert check.is_safe.tolist() == [True, False, False, True]
    assert check.message == (
        f"2 of 4 rows are not safe to play: {breach.name} falls to 0.2 N at row 2 (at least 2 N asked)"
    )


def test_motor_and_strength_and_rest_are_named_the_gravest_first():
    tension = np.full((4, 8), 15.0)
    tension[0, 2] = 15.0 + 246.0  # cable 1's difference, above the motors' 245 N
    tension[1, :2] = 600.0  # the physics clips at the strength; no difference for the motor
    converged = np.array([True, True, True, False])
    tension[3] = 0.0  # not at rest: its tension says nothing
    check = TensionCheck(ARM, rest(tension, converged), 2.0)
    assert [breach.kind for breach in check.breaches] == ["unsettled", "strength", "motor"]
    assert [breach.row for breach in check.breaches] == [3, 1, 0]
    assert check.breaches[2].name == f"cable_{ARM.config.cables.names[0][1]}"
    assert check.breaches[2].value == 246.0
    assert check.message.startswith("3 of 4 rows are not safe to play: row 3 does not come to rest (0.5 rad/s left); ")
    assert "needs 246 N at row 0 (its motor's 245 N)" in check.message


def test_the_physics_shows_a_slack_strand_that_more_pretension_keeps_taut():
    bends = random_bends(ARM, 24, seed=3)
    lengths = over_rows(cable_lengths, ARM, bends)
    tensest = robot_from_mapping(altered("qj_22", strands__pretension=60.0))
    loose = robot_from_mapping(altered("qj_22", strands__pretension=1.0))
    assert check_tension(tensest, lengths, 2.0).is_safe.all()
    check = check_tension(loose, lengths, 2.0)
    (slack,) = [breach for breach in check.breaches if breach.kind == "slack"]
    assert not check.is_safe[slack.row] and slack.num_rows == check.is_slack.any(axis=1).sum() > 0
    assert slack.value == check.rest.strand_tension[check.rest.converged].min()
