"""What is said of strands and motors while a trajectory is played."""

import dataclasses

import numpy as np
import pytest
from arms import altered, arm_named, over_rows

from qjrl.control.tracking.moving import moving_breaches, moving_message
from qjrl.control.tracking.playing import Performance, Played, play
from qjrl.control.tracking.trajectory import MotionLimits, straight_path, time_path
from qjrl.robot import cable_lengths, robot_from_mapping
from qjrl.simulation import SettleConfig, settle

ARM = arm_named("qj_22")
TIMES = 0.01 * np.arange(-2, 98)


def played_with(tension: np.ndarray) -> Played:
    """Strands that carry what is given (n, strands)."""
    empty = np.zeros((len(TIMES), 0))
    return Played(TIMES, empty, empty, empty, tension, 0.0, True)


def test_taut_strands_within_the_motors_force_are_no_news() -> None:
    breaches = moving_breaches(ARM, played_with(np.full((100, 8), 15.0)))
    assert breaches == [] and moving_message(breaches) == ""


def test_every_slack_strand_and_exceeded_motor_is_named_with_its_times() -> None:
    tension = np.full((100, 8), 15.0)
    tension[12:15, 3] = 0.005  # a strand of the second cable, for 0.03 s from 0.1 s
    tension[13, 3] = 0.0
    tension[50, 2] = 0.0
    tension[70:72, 4] = ARM.config.motors.force + np.array([20.0, 40.0])  # less its partner's 15 N
    tension[90, 6] = ARM.config.strands.strength
    breaches = moving_breaches(ARM, played_with(tension))
    numbers = [number for pair in ARM.config.cables.names for number in pair]
    slack, cable = [f"strand_{numbers[1]}_{letter}" for letter in "ba"], f"cable_{numbers[2]}"
    assert [breach.kind for breach in breaches] == ["strength", "motor", "motor", "slack", "slack"]
    assert [breach.name for breach in breaches[3:]] == slack
    motor = next(breach for breach in breaches if breach.name == cable)
    assert (motor.first_s, motor.worst_s) == (pytest.approx(0.68), pytest.approx(0.69))
    assert motor.total_s == pytest.approx(0.02) and motor.value_newton == pytest.approx(ARM.config.motors.force + 25.0)
    assert breaches[3].first_s == pytest.approx(0.10) and breaches[3].worst_s == pytest.approx(0.11)
    assert f"{slack[0]} goes slack at 0.11 s, for 0.030 s in all (and 1 more)" in moving_message(breaches)
    assert f"{cable} needs {motor.value_newton:.0f} N at 0.69 s" in moving_message(breaches)


def test_a_motor_that_holds_every_rest_but_not_the_motion_is_named() -> None:
    """The same play, its motors taken to be as strong as the rests at both ends ask, and a little more."""
    end = over_rows(cable_lengths, ARM, np.array([[[0.1, 0.05], [0.1, 0.1]]]))[0]
    plan = time_path(straight_path(end), float(ARM.motor_speed), MotionLimits())  # begins at home
    played = play(ARM, SettleConfig(), [Performance(plan)], 0.02, MotionLimits())[0]
    rests = np.abs(settle(ARM, plan.lengths(np.linspace(0.0, 1.0, 33))).motor_force).max()
    most = np.abs(played.motor_force).max()
    assert most > 1.1 * rests
    weak = robot_from_mapping(altered("qj_22", motors__force=float(0.5 * (most + rests))))
    breaches = moving_breaches(weak, played)
    assert breaches and {breach.kind for breach in breaches} == {"motor"}
    worst = max(breaches, key=lambda one: abs(one.value_newton))
    assert abs(worst.value_newton) == pytest.approx(most)
    assert -0.1 < worst.worst_s < plan.duration + 0.2
    assert dataclasses.asdict(worst)["bound_newton"] == weak.config.motors.force
