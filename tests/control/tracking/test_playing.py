import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named
from scipy.interpolate import make_interp_spline

from qjrl.control.path.paths import LineConfig, ShapeConfig, make_path
from qjrl.control.tracking.playing import Performance, Played, evaluate, play
from qjrl.control.tracking.trajectory import MotionLimits, time_path
from qjrl.robot import cable_lengths
from qjrl.simulation import SettleConfig, settle

ARM = arm_named("qj_22")
SPEED, LIMITS, PERIOD = float(ARM.motor_speed), MotionLimits(), 0.02
PATH = make_path("line", ShapeConfig(line=LineConfig((0.0, 0.0, 0.2), (0.03, 0.04, 0.2))))


def small_motion(speed=0.5):
    """Cables that swing both segments out by some degrees, over the length of PATH."""
    ends = np.array(
        [cable_lengths(ARM, jnp.array(bends)) for bends in ([[0.05, 0.0], [0.0, 0.1]], [[0.1, 0.1], [0.15, 0.0]])]
    )
    share = np.linspace(0.0, 1.0, 20)[:, None]
    return time_path(
        make_interp_spline(PATH.length * share[:, 0], ends[0] + share * (ends[1] - ends[0]), k=5), SPEED, LIMITS, speed
    )


def played_as(plan, pose_at):
    times = np.arange(-0.1, plan.duration + 0.1, 0.004)
    empty = np.zeros((len(times), 0))
    return Played(times, empty, pose_at(times), empty, empty, 0.0, True)


def test_a_tip_that_is_late_shows_its_lag_and_no_error_across() -> None:
    plan, lag = small_motion(), 0.013
    errors = evaluate(plan, PATH, played_as(plan, lambda times: PATH.at(plan.distances(times - lag))))
    assert errors.across.max() < 1e-9
    np.testing.assert_allclose(errors.along, -errors.position, atol=1e-12)
    moving = errors.speed > 0.5 * errors.speed.max()
    np.testing.assert_allclose(-errors.along[moving] / errors.speed[moving], lag, rtol=0.35)
    assert -(errors.along @ errors.speed) / (errors.speed @ errors.speed) == pytest.approx(lag, rel=0.03)
    assert errors.orientation.max() < 1e-9


def test_a_tip_beside_the_path_shows_its_distance_and_no_lag() -> None:
    plan, beside = small_motion(), 1e-3 * np.array([-0.8, 0.6, 0.0])  # square to the line

    def pose_at(times):
        return PATH.at(plan.distances(times)) + np.concatenate([beside, np.zeros(6)])

    errors = evaluate(plan, PATH, played_as(plan, pose_at))
    np.testing.assert_allclose(errors.across, 1e-3, atol=1e-9)
    np.testing.assert_allclose(errors.along, 0.0, atol=1e-9)
    assert errors.speed.max() == pytest.approx(plan.distances(np.linspace(0, plan.duration, 5001), 1).max(), rel=1e-3)


@pytest.fixture(scope="module")
def performances():
    plan = small_motion()
    slow = dataclasses.replace(plan, speed=0.05)
    return [Performance(plan), Performance(plan, 0.03), Performance(plan, 0.01, True), Performance(slow)]


@pytest.fixture(scope="module")
def played(performances):
    return play(ARM, SettleConfig(), performances, PERIOD, LIMITS)


def test_the_motors_get_the_commands_of_the_plan_at_its_times(performances, played) -> None:
    plan, times = performances[0].trajectory, played[0].time
    at_ends = np.isclose(times % PERIOD, 0.002, atol=1e-9) | np.isclose(times % PERIOD, 0.004, atol=1e-9)
    middle = times - 0.002
    begin = PERIOD * np.floor(middle / PERIOD)
    assert at_ends.any()
    share = ((middle - begin) / PERIOD)[:, None]
    evenly = (1 - share) * plan.at(begin) + share * plan.at(begin + PERIOD)
    np.testing.assert_allclose(played[0].command, evenly, atol=1e-12)
    np.testing.assert_allclose(played[2].command, plan.at(begin + 0.01), atol=1e-12)
    rates = np.abs(np.diff(played[1].command, axis=0)).max() / 0.004
    assert rates <= SPEED * 0.5 * (1 + 1e-9)  # half of the feasible speed, lead or not


def test_it_starts_at_rest_where_the_plan_starts_and_ends_where_it_rests(performances, played) -> None:
    plan = performances[0].trajectory
    ends = settle(ARM, plan.at(np.array([0.0, plan.duration])))
    for one in played:
        assert one.is_finite and one.rest_speed < 1e-3
        assert one.time[0] < -performances[1].lead
        np.testing.assert_allclose(one.pose[0], ends.pose[0], atol=1e-4)
    np.testing.assert_allclose(played[0].pose[-1], ends.pose[1], atol=3e-4)
    np.testing.assert_allclose(played[0].strand_tension[0], ends.strand_tension[0], atol=0.2)


def test_played_slowly_the_tip_goes_where_the_same_cables_rest(performances, played) -> None:
    slow = performances[3].trajectory
    times = np.linspace(0.1, 0.9, 9) * slow.duration
    rest = settle(ARM, slow.at(times))
    found = np.array([np.interp(times, played[3].time, column) for column in played[3].pose[:, :3].T]).T
    np.testing.assert_allclose(found, rest.pose[:, :3], atol=2e-4)


def test_a_lead_brings_the_tip_forward_in_time(performances, played) -> None:
    """The same motion, earlier by the lead."""
    early = np.array([np.interp(played[0].time - 0.03, played[1].time, column) for column in played[1].pose[:, :3].T]).T
    inside = (played[0].time > 0.1) & (played[0].time < performances[0].trajectory.duration)
    np.testing.assert_allclose(early[inside], played[0].pose[inside, :3], atol=2e-4)
    assert np.abs(played[1].pose[inside, :3] - played[0].pose[inside, :3]).max() > 2e-4
