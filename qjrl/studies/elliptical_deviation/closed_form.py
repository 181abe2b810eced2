"""How far a rolling joint's path leaves the circle of the spherical model: H(theta) - H0, over the joint's dimensions.

Source: paper 000, section 5.5 and Fig. 11, from the closed form of the planar antiparallelogram. For small angles the
deviation is (k^2 / (2 h0) - d) theta^2 / 4: outward for small d, inward for large d, of fourth order where both cancel.
"""

import dataclasses

import numpy as np

from qjrl.robot.quaternion_arm.joint import height_of_cosine

LARGEST_ANGLE = np.radians(89.0)
"""Up to here the end of the low error is looked for [rad]."""


@dataclasses.dataclass(frozen=True)
class DeviationMap:
    """Deviations over pin distances (rows) and offsets (columns) at one height at home; all lengths in m."""

    pin_distance: np.ndarray
    """(rows,) k."""
    plate_to_pin: np.ndarray
    """(columns,) d."""
    near: np.ndarray
    """(rows, columns) deviation at the near angle."""
    far: np.ndarray
    """(rows, columns) deviation at the far angle."""
    low_error_end: np.ndarray
    """(rows, columns) [rad]."""
    is_as_described: np.ndarray
    """(rows, columns) whether the path is that of the paper's section 5.5."""


def crossed_link_length(pin_distance, plate_to_pin, home_height):
    """l [m] of a joint whose plates are `home_height` = sqrt(l^2 - k^2) + 2 d apart at home."""
    return np.sqrt((home_height - 2.0 * np.asarray(plate_to_pin)) ** 2 + np.asarray(pin_distance) ** 2)


def deviation(pin_distance, plate_to_pin, home_height, angle) -> np.ndarray:
    """H(theta) - H0 [m]; + is outward of the circle. All arguments broadcast, lengths [m] and angle [rad]."""
    length = crossed_link_length(pin_distance, plate_to_pin, home_height)
    return height_of_cosine(length, pin_distance, plate_to_pin, np.cos(np.asarray(angle) / 2.0)) - home_height


def low_error_end(pin_distance: float, plate_to_pin: float, home_height: float, share: float) -> float:
    """First angle [rad] at which |H - H0| exceeds `share` of H0; NaN where it does not up to 89 degrees."""
    angles = np.linspace(0.0, LARGEST_ANGLE, 891)
    excess = np.abs(deviation(pin_distance, plate_to_pin, home_height, angles)) - share * home_height
    above = np.nonzero(excess > 0.0)[0]
    if not len(above):
        return float("nan")
    last = above[0]
    return float(np.interp(0.0, excess[last - 1 : last + 1], angles[last - 1 : last + 1]))


def cancelling_offset(pin_distance: float, home_height: float) -> float:
    """The smaller offset d [m] with d = k^2 / (2 h0), h0 = H0 - 2 d, where the quadratic deviation vanishes; NaN for k > H0/2."""
    discriminant = home_height**2 - 4.0 * pin_distance**2
    return float((home_height - np.sqrt(discriminant)) / 4.0) if discriminant >= 0.0 else float("nan")


def is_as_described(near, far, home_height: float, share: float, growth: float):
    """Section 5.5 in numbers: minimal up to the near angle, inward at the far one, and `growth` times as large there.

    Args:
        near, far: deviations [m] at the two angles.
        share: of H0, what counts as minimal.
    """
    return (np.abs(near) <= share * home_height) & (far < 0.0) & (np.abs(far) >= growth * np.abs(near))


def deviation_map(
    largest: tuple[float, float], home_height: float, angles: tuple[float, float], share: float, growth: float,
    resolution: int = 121,
) -> DeviationMap:  # fmt: skip
    """The map over 0 <= k <= largest[0] and 0 <= d <= largest[1] [m], at the near and the far angle [rad]."""
    pins, offsets = (np.linspace(0.0, high, resolution) for high in largest)
    k, d = pins[:, None], offsets[None, :]
    near, far = (deviation(k, d, home_height, angle) for angle in angles)
    ends = [[low_error_end(float(pin), float(offset), home_height, share) for offset in offsets] for pin in pins]
    described = is_as_described(near, far, home_height, share, growth)
    return DeviationMap(pins, offsets, near, far, np.array(ends), described)
