"""What describes a continuum arm: the values of its YAML, checked."""

from typing import Annotated, Literal

from qjrl.config import Range, configuration
from qjrl.robot.descriptions import NonNegative, Number, Positive, check_name
from qjrl.robot.unit_hints import length_hint


@configuration
class SegmentsConfig:
    """Shape of the segments, from the base; one number each."""

    lengths: tuple[Annotated[float, Positive], ...]
    """Length L of each segment's backbone [m]."""
    anchor_radii: tuple[Annotated[float, Positive], ...]
    """Radius r of the circle of each segment's anchors [m]."""
    bend_limit_deg: Annotated[float, Range(above=0.0, high=170.0)]
    """Largest commanded bend angle theta of a segment [deg]; the paper has up to 90."""


@configuration
class CablesConfig:
    """Cables end at the upper disc of their segment; each is pulled by a motor of its own."""

    anchor_angles_deg: tuple[tuple[float, ...], ...]
    """Azimuth of every anchor, on both discs of its segment [deg]; the paper's run clockwise: 0, -90, -180, -270."""
    names: tuple[tuple[Number, ...], ...]
    """The number each cable goes by on the machine, per segment."""
    stiffness: Annotated[float, Positive]
    """Of one cable in its segment [N/m]."""
    pretension: Annotated[float, NonNegative]
    """Tension of every cable of the straight arm without gravity [N]."""
    friction_coefficient: Annotated[float, Range(low=0.0, high=1.0)]
    """Of a cable in its guides, by the capstan's law."""
    wrap_angle: Annotated[float, NonNegative]
    """What a cable is bent by in its guides before its first segment [rad]."""
    strength: Annotated[float, Positive]
    """Largest tension of a cable [N]."""


@configuration
class RodConfig:
    """The backbone of a segment."""

    bending_stiffness: Annotated[float, Positive]
    """EI [N m^2]."""
    torsional_stiffness: Annotated[float, Positive]
    """GJ [N m^2]."""
    axial_stiffness: Annotated[float, Positive]
    """EA [N]."""


@configuration
class MassesConfig:
    """What gravity pulls at."""

    disc: Annotated[float, NonNegative]
    """Of each segment's upper disc [kg]."""
    disc_depth: float
    """How far its centre lies behind the disc's face, the segment's end [m]."""
    hose: Annotated[float, NonNegative]
    """Of each segment's backbone, evenly along it [kg]."""
    payload: Annotated[float, NonNegative]
    """At the tip [kg]."""
    payload_height: float
    """How far its centre lies before the last disc's face [m]."""
    gravity: tuple[float, float, float]
    """In the base frame, whose z is the straight arm [m/s^2]."""


@configuration
class DefectsConfig:
    """Standard deviations of what a real arm has and its description does not say: one draw a seed, which no model sees."""

    seed: Annotated[int, Range(0, 2**31 - 1)]
    """Of the draw."""
    anchor_position: Annotated[float, NonNegative]
    """Of each coordinate of every anchor [m]."""
    home_length: Annotated[float, NonNegative]
    """Of every cable's length at home [m]."""
    cable_gain: Annotated[float, Range(low=0.0, high=0.2)]
    """Of every cable's length a unit of its command, about 1."""
    tip_angle_deg: Annotated[float, Range(low=0.0, high=30.0)]
    """Of the tip's frame about each axis [deg]."""
    preset_bend: Annotated[float, Range(low=0.0, high=1.0)]
    """Of each segment's bend without forces, in both directions [rad]."""


@configuration
class MeasurementConfig:
    """Standard deviations of what measures the tip."""

    position: Annotated[float, NonNegative]
    """Of each coordinate [m]."""
    angle_deg: Annotated[float, Range(low=0.0, high=30.0)]
    """About each axis [deg]."""


@configuration
class MotorsConfig:
    """One motor a cable."""

    speed: Annotated[float, Positive]
    """Largest cable speed [m/s]."""
    force: Annotated[float, Positive]
    """Largest tension [N]."""
    pulley_radius: Annotated[float, Positive]
    """[m]."""


@configuration
class ContinuumArmConfig:
    """The YAML of an arm (`kind: continuum_arm`, `schema: 1`)."""

    kind: Literal["continuum_arm"]
    schema: Literal[1]
    name: str
    segments: SegmentsConfig
    cables: CablesConfig
    rod: RodConfig
    masses: MassesConfig
    defects: DefectsConfig
    measurement: MeasurementConfig
    motors: MotorsConfig

    def __post_init__(self):
        check_name(self.name)
        count = len(self.segments.lengths)
        if count == 0:
            raise ValueError("segments.lengths: got [], allowed: at least one segment")
        angles, names = self.cables.anchor_angles_deg, self.cables.names
        per_segment = {"segments.anchor_radii": self.segments.anchor_radii}
        per_segment |= {"cables.anchor_angles_deg": angles, "cables.names": names}
        for key, values in per_segment.items():
            if len(values) != count:
                raise ValueError(f"{key}: got {len(values)} entries, allowed: one for each of the {count} segments")
        num_cables = {len(row) for row in (*angles, *names)}
        if len(num_cables) != 1 or min(num_cables) < 3:
            raise ValueError(
                f"cables.anchor_angles_deg: got {[len(row) for row in angles]} and names {[len(row) for row in names]}, "
                "allowed: the same number in every segment, at least 3"
            )
        every = [name for row in names for name in row]
        if len(set(every)) != len(every):
            raise ValueError(f"cables.names: got {every}, allowed: all different")
        for number, row in enumerate(angles):
            _check_angles(number, row)
        for number, (radius, length) in enumerate(zip(self.segments.anchor_radii, self.segments.lengths, strict=True)):
            if radius > 10.0 * length:
                raise ValueError(
                    f"segments.anchor_radii: got {radius:g} m in segment {number} (the first is 0), allowed: up to ten "
                    f"times its length of {length:g} m{length_hint(radius / (10.0 * length))}"
                )


def _check_angles(segment: int, angles: tuple[float, ...]) -> None:
    """Anchors all round: cables that only pull must be able to pull everywhere."""
    turned = sorted(angle % 360.0 for angle in angles)
    gaps = [second - first for first, second in zip(turned, [*turned[1:], turned[0] + 360.0], strict=True)]
    if min(gaps) < 1.0 or max(gaps) >= 180.0:
        largest = max(abs(angle) for angle in angles)
        hint = "; in radians? multiply by 57.3" if 0.0 < largest <= 6.3 else ""
        raise ValueError(
            f"cables.anchor_angles_deg: got {list(angles)} in segment {segment} (the first is 0), allowed: all different by "
            f"1 deg or more, with less than 180 deg between neighbours{hint}"
        )
