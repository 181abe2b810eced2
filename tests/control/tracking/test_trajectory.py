import functools

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from qjrl.control.tracking.trajectory import MotionLimits, least_duration, straight_path, time_path

SPEED, LIMITS = 0.0314, MotionLimits(0.3, 6.0)
PLACES = np.linspace(0.0, 0.3, 200)
PHASES = np.arange(8) * 0.9
PATHS = {
    "circle": make_interp_spline(PLACES, 0.012 * np.sin(21.0 * PLACES[:, None] + PHASES), k=5),
    "straight": straight_path(np.array([0.01, -0.05, 0.03])),
    "short": straight_path(np.array([2e-5, 0.0, -1e-5])),
    "sharp": make_interp_spline(PLACES, 0.02 * np.tanh(60.0 * (PLACES[:, None] - [0.1, 0.15, 0.2])), k=5),
    "one cable, back and forth": make_interp_spline(PLACES, 0.02 * np.sin(40.0 * PLACES[:, None]), k=5),
}


@functools.cache
def timed(name, speed=1.0):
    return time_path(PATHS[name], SPEED, LIMITS, speed)


@pytest.mark.parametrize("speed", [1.0, 0.37])
@pytest.mark.parametrize("name", PATHS)
def test_every_limit_holds_at_every_instant_and_in_every_command(name, speed) -> None:
    trajectory = timed(name, speed)
    times = np.linspace(0.0, trajectory.duration, 20_001)
    bounds = (SPEED, LIMITS.acceleration, LIMITS.jerk)
    for order, (values, bound) in enumerate(zip(trajectory.derivatives(times), bounds, strict=True), 1):
        assert np.abs(values).max() <= bound * speed**order
    commands = trajectory.at(np.arange(-0.2, trajectory.duration + 0.2, 0.02))
    for order, bound in enumerate(bounds, 1):
        assert np.abs(np.diff(commands, order, axis=0)).max() / 0.02**order <= bound * speed**order * (1 + 1e-9)


@pytest.mark.parametrize("name", PATHS)
def test_it_starts_and_ends_at_rest_exactly_and_never_runs_back(name) -> None:
    trajectory = timed(name, 0.5)
    ends = np.array([0.0, trajectory.duration])
    np.testing.assert_allclose(trajectory.distances(ends), [0.0, PATHS[name].t[-1]], rtol=1e-12, atol=1e-15)
    for values, bound in zip(trajectory.derivatives(ends), (SPEED, LIMITS.acceleration, LIMITS.jerk), strict=True):
        assert np.abs(values).max() < 1e-9 * bound
    assert np.diff(trajectory.distances(np.linspace(-0.1, trajectory.duration + 0.1, 5001))).min() >= -1e-15
    np.testing.assert_array_equal(trajectory.at(ends + np.array([-1.0, 1.0])), trajectory.at(ends))


@pytest.mark.parametrize("name", PATHS)
def test_derivatives_are_those_of_the_lengths(name) -> None:
    trajectory = timed(name)
    times, step = np.linspace(0.05, 0.95, 50) * trajectory.duration, 1e-4 * trajectory.duration
    ahead, here, behind = (trajectory.at(times + offset) for offset in (step, 0.0, -step))
    speed, acceleration, jerk = trajectory.derivatives(times)
    np.testing.assert_allclose((ahead - behind) / (2 * step), speed, atol=1e-4 * SPEED)
    np.testing.assert_allclose((ahead - 2 * here + behind) / step**2, acceleration, atol=0.01 * LIMITS.acceleration)
    faster, slower = (trajectory.derivatives(times + offset)[1] for offset in (step, -step))
    np.testing.assert_allclose((faster - slower) / (2 * step), jerk, atol=0.05 * LIMITS.jerk)


def test_a_long_straight_way_takes_little_more_than_the_quickest_profile_there_is() -> None:
    """The optimum of one degree of freedom, rest to rest: distance / speed + speed / acceleration + acceleration / jerk."""
    optimum = 0.05 / SPEED + SPEED / LIMITS.acceleration + LIMITS.acceleration / LIMITS.jerk
    quickest = timed("straight").quickest
    assert optimum <= quickest < 1.1 * optimum


def test_no_trajectory_is_quicker_than_the_speed_limit_allows() -> None:
    for name, path in PATHS.items():
        assert least_duration(path, SPEED) < timed(name).quickest
    assert least_duration(PATHS["straight"], SPEED) == pytest.approx(0.05 / SPEED)


def test_half_the_speed_takes_twice_the_time_along_the_same_places() -> None:
    fast, slow = (timed("circle", speed) for speed in (1.0, 0.5))
    times = np.linspace(0.0, fast.duration, 101)
    assert slow.duration == 2.0 * fast.duration
    np.testing.assert_allclose(slow.at(2.0 * times), fast.at(times), atol=1e-12)
