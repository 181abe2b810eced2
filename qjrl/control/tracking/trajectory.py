"""When to be where along a cable path: from rest to rest, no cable beyond its speed, acceleration and jerk.

The largest speed that each place allows by itself is lowered until braking and starting reach it (a pass in each
direction); the distances it reaches at even times are the control points of a quintic B-spline, which smooths them like
six moving averages and rests exactly at both ends; and time is stretched until the nearest limit is just held at every
instant. Of a few knot distances and shares of acceleration the quickest is taken: simple, and right by construction.
"""

import dataclasses
import itertools
from typing import Annotated

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from qjrl.config import Range, configuration


@configuration
class MotionLimits:
    """Of every cable, beside the motors' speed; ours."""

    acceleration: Annotated[float, Range(above=0.0)] = 0.3
    """[m/s^2]."""
    jerk: Annotated[float, Range(above=0.0)] = 6.0
    """[m/s^3]."""


@dataclasses.dataclass(frozen=True)
class CableTrajectory:
    """Cable lengths over time."""

    lengths: BSpline
    """distance along the path [m] -> (num_cables,) [m]."""
    distance: BSpline
    """time [s] at the quickest -> distance along the path [m]."""
    quickest: float
    """Duration at which a limit is just held [s]."""
    speed: float
    """Share of the quickest speed that is used."""

    @property
    def duration(self) -> float:
        """[s]."""
        return self.quickest / self.speed

    def distances(self, times: np.ndarray, order: int = 0) -> np.ndarray:
        """Distance along the path (n,) at times [s], or its derivative of an order up to 3; at rest before and after."""
        inside = np.clip(self.speed * np.asarray(times, float), 0.0, self.quickest)
        values = self.distance(inside, order) * self.speed**order
        return values if order == 0 else np.where(inside == self.speed * np.asarray(times), values, 0.0)

    def at(self, times: np.ndarray) -> np.ndarray:
        """Cable lengths (n, num_cables) [m] at times [s]; at rest before 0 and after the duration."""
        return self.lengths(self.distances(times))

    def derivatives(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocity, acceleration and jerk (n, num_cables) of the cables at times [s]."""
        moved = [self.distances(times, order) for order in range(4)]
        return _chain_rule([self.lengths(moved[0], order) for order in (1, 2, 3)], moved[1:])


def time_path(lengths: BSpline, speed_limit: float, limits: MotionLimits, speed: float = 1.0) -> CableTrajectory:
    """The quickest trajectory found along a cable path, then slowed down to a share `speed` of it.

    Args:
        lengths: distance [m] from 0 -> cable lengths [m], with three derivatives.
        speed_limit: of every cable [m/s].
    """
    laws = [
        _one_law(lengths, speed_limit, limits, share, window) for share, window in itertools.product(_SHARES, _WINDOWS)
    ]
    law, duration = min(laws, key=lambda pair: pair[1])
    return CableTrajectory(lengths, law, duration, speed)


def least_duration(lengths: BSpline, speed_limit: float) -> float:
    """What no trajectory along the path can be quicker than: the speed limit alone, always at it [s]."""
    distance, (rate, _, _) = _sampled(lengths)
    return float(np.trapezoid(rate, distance)) / speed_limit


def straight_path(end: np.ndarray) -> BSpline:
    """The cable path from home straight to lengths (num_cables,) [m], over a distance from 0 to 1."""
    knots = np.linspace(0.0, 1.0, 8)
    return make_interp_spline(knots, knots[:, None] * np.asarray(end), k=5)


def _one_law(
    lengths: BSpline, speed_limit: float, limits: MotionLimits, share: float, window: float
) -> tuple[BSpline, float]:
    """Distance over time, and the duration."""
    distance, (rate, bend, twist) = _sampled(lengths)
    rest = 1.0 - share
    ceiling = np.minimum.reduce([
        speed_limit / rate,
        np.sqrt(rest * limits.acceleration / bend),
        np.cbrt(rest * limits.jerk / twist),
    ])  # fmt: skip
    squared = _reachable(distance, ceiling**2, share * limits.acceleration / rate)
    law = _smoothed(distance, squared, window * share * limits.acceleration / limits.jerk)
    stretch = _stretch(lengths, law, speed_limit, limits)
    return BSpline(stretch * law.t, law.c, _DEGREE), stretch * _end_of(law)


def _sampled(lengths: BSpline) -> tuple[np.ndarray, list[np.ndarray]]:
    """Places along the path, and there the largest |derivative| of any cable of order 1, 2, 3, kept off zero."""
    end = float(lengths.t[-1])
    distance = np.linspace(0.0, end, _PLACES + 1)
    sizes = [np.abs(lengths(distance, order)).max(axis=1) for order in (1, 2, 3)]
    return distance, [
        np.maximum(size, max(1e-9 * sizes[0].max() / end**order, 1e-12)) for order, size in enumerate(sizes)
    ]


def _reachable(distance: np.ndarray, ceiling: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Squared speeds under a ceiling, from rest to rest, that change by at most 2 acceleration a distance."""
    squared, gain = ceiling.copy(), 2.0 * np.diff(distance) * np.minimum(acceleration[1:], acceleration[:-1])
    squared[0] = squared[-1] = 0.0
    for index in range(len(gain)):
        squared[index + 1] = min(squared[index + 1], squared[index] + gain[index])
    for index in reversed(range(len(gain))):
        squared[index] = min(squared[index], squared[index + 1] + gain[index])
    return squared


def _smoothed(distance: np.ndarray, squared: np.ndarray, step: float) -> BSpline:
    """Distance over time from time 0, of a profile of squared speeds; knots lie `step` [s] apart.

    A B-spline's derivatives are averages of its control points' differences: it never runs back, and where as many
    control points as its degree are equal, it stands still.
    """
    speed = np.sqrt(squared)
    arrival = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(distance) / (speed[1:] + speed[:-1]))])
    moving = np.interp(step * np.arange(1, int(arrival[-1] / step) + 1), arrival, distance)
    still = np.ones(_DEGREE)
    points = np.concatenate([distance[0] * still, moving, distance[-1] * still])
    return BSpline(step * (np.arange(len(points) + _DEGREE + 1) - _DEGREE), points, _DEGREE)


def _end_of(law: BSpline) -> float:
    return float(law.t[len(law.c)])


def _stretch(lengths: BSpline, law: BSpline, speed_limit: float, limits: MotionLimits) -> float:
    """By how much all times must grow for the limits to hold, just."""
    times = np.linspace(0.0, _end_of(law), 8 * len(law.c) + 1000)
    moved = [law(times, order) for order in range(4)]
    derivatives = _chain_rule([lengths(moved[0], order) for order in (1, 2, 3)], moved[1:])
    bounds = (speed_limit, limits.acceleration, limits.jerk)
    used = [np.abs(values).max() / bound for values, bound in zip(derivatives, bounds, strict=True)]
    return max(share ** (1.0 / order) for order, share in enumerate(used, 1)) * (1.0 + _MARGIN)


def _chain_rule(path: list[np.ndarray], law: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives 1, 2, 3 over time of a path (n, cables) by distance, and a law (n,) by time."""
    (u1, u2, u3), (s1, s2, s3) = path, (part[:, None] for part in law)
    return u1 * s1, u2 * s1**2 + u1 * s2, u3 * s1**3 + 3.0 * u2 * s1 * s2 + u1 * s3


# Shares of the acceleration that starting and braking get, and distances of knots in units of the time its jerk takes.
_SHARES, _WINDOWS = (0.5, 0.7, 0.9), (0.4, 0.6, 0.9, 1.3)
# Places along the path; degree of the law, whose third derivative is continuous.
_PLACES, _DEGREE = 2000, 5
# Between the instants at which limits are checked.
_MARGIN = 1e-3
