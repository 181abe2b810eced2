"""Whether the values of a description fit each other, each being allowed alone: an arm in other units is refused here.

Bounds are far from any arm that could be built, so that a refusal means a slip. `get` are plain values of the description,
so that the description's own module can ask.
"""

import math
from typing import Any

from qjrl.robot.unit_hints import angle_hint, length_hint

# Straight, base to tip [m].
_LONGEST_ARM = 20.0
# A length of one part over the largest of the joint's and the cables'.
_LARGEST_RATIO = 100.0
# [m/s], [m/s^2].
_FASTEST_CABLE, _LARGEST_GRAVITY = 20.0, 100.0
# Ten times osmium [kg/m^3].
_LARGEST_DENSITY = 2e5
# In radians every limit below 90 degrees is smaller [deg].
_SMALLEST_LIMIT = 90.0 / 57.29578


def check_dimensions(config: Any) -> None:
    """Refuse a `QuaternionArmConfig` whose values contradict each other.

    Raises:
        ValueError: one line that names the key, with the unit that would explain the value.
    """
    joint, cables, strands = config.joint, config.cables, config.strands
    height = math.sqrt(joint.crossed_link_length**2 - joint.pin_distance**2) + 2.0 * joint.plate_to_pin
    length = sum(config.joints_per_segment) * (height + config.link_length)
    _check_ratios(config, max(joint.crossed_link_length, cables.hole_circle_diameter))
    if length > _LONGEST_ARM:
        raise ValueError(
            f"link_length: got {config.link_length:g} with joints {height:g} m high, an arm {length:.4g} m long, allowed: up "
            f"to {_LONGEST_ARM:g} m{length_hint(length / _LONGEST_ARM)}"
        )
    _below("motors.speed", config.motors.speed, _FASTEST_CABLE, "m/s", length_hint)
    gravity = math.hypot(*config.mechanics.gravity)
    _below("mechanics.gravity", gravity, _LARGEST_GRAVITY, "m/s^2", length_hint)
    if joint.bend_limit_deg < _SMALLEST_LIMIT:
        raise ValueError(
            f"joint.bend_limit_deg: got {joint.bend_limit_deg:g}, allowed: at least {_SMALLEST_LIMIT:.4g} degrees"
            f"{angle_hint(joint.bend_limit_deg, _SMALLEST_LIMIT)}"
        )
    _check_masses(config.mechanics, max(height + config.link_length, 1e-3))
    _check_strands(strands, length)


def _check_ratios(config: Any, scale: float) -> None:
    """Every length against the larger of the crossed links and the hole circle [m]."""
    lengths = {
        "joint.plate_to_pin": config.joint.plate_to_pin,
        "link_length": config.link_length,
        "mechanics.link_radius": config.mechanics.link_radius,
        "motors.pulley_radius": config.motors.pulley_radius,
    }
    for key, value in lengths.items():
        _below(key, value, _LARGEST_RATIO * scale, "m, a hundred times the joints' own size", length_hint)


def _check_masses(mechanics: Any, height: float) -> None:
    """A joint with its link against a solid cylinder of that size."""
    largest = _LARGEST_DENSITY * math.pi * mechanics.link_radius**2 * height
    for key in ("joint_mass", "link_mass"):
        hint = lambda excess: "; in grams? divide by 1,000" if excess <= 1000.0 else ""  # noqa: E731
        _below(f"mechanics.{key}", getattr(mechanics, key), largest, "kg for a link of this size", hint)


def _check_strands(strands: Any, length: float) -> None:
    if strands.pretension >= strands.strength:
        raise ValueError(
            f"strands.pretension: got {strands.pretension:g}, allowed: below strands.strength = {strands.strength:g}, at "
            "which a strand breaks"
        )
    stretch = strands.pretension / strands.stiffness
    hint = "; in N/mm? multiply by 1,000" if stretch <= 1000.0 * length else ""
    if stretch > length:
        raise ValueError(
            f"strands.stiffness: got {strands.stiffness:g}, allowed: at least {strands.pretension / length:.3g} N/m, with "
            f"which the pretension stretches a strand by the whole arm's length{hint}"
        )


def _below(key: str, value: float, allowed: float, unit: str, hint: Any) -> None:
    if value > allowed:
        raise ValueError(f"{key}: got {value:g}, allowed: up to {allowed:.4g} {unit}{hint(value / allowed)}")
