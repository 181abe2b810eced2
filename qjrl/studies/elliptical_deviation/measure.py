"""The study of the elliptical deviation: its configuration, what is measured of each joint, the numbers and the tables."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from qjrl.config import Range, configuration
from qjrl.report.tables import Column, Table
from qjrl.robot.verbs import Robot
from qjrl.simulation import SettleConfig
from qjrl.simulation.settling import SLACK_TENSION
from qjrl.studies.elliptical_deviation import closed_form
from qjrl.studies.elliptical_deviation.closed_form import DeviationMap, deviation_map
from qjrl.studies.elliptical_deviation.effects import (
    ArmEffects,
    SettledEffects,
    arm_with_joint,
    draw_limited_bends,
    effects_on_arm,
    home_height,
    settled_effects,
)

MM = 1e-3
"""[m]."""
AS_DESCRIBED = "as described"
"""Label of the robot's own joint."""


@configuration
class JointVariant:
    """A joint of the robot's height at home with other pins."""

    label: str
    """As shown."""
    pin_distance: Annotated[float, Range(low=0.0, high=0.5)]
    """k [m]."""
    plate_to_pin: Annotated[float, Range(low=0.0, high=0.5)]
    """d [m]."""


@configuration
class DeviationConfig:
    """Group `elliptical_deviation`."""

    variants: tuple[JointVariant, ...] = (
        JointVariant("no offset", 0.020, 0.0),
        JointVariant("small, no offset", 0.010, 0.0),
        JointVariant("inward", 0.010, 0.00486),
    )
    """Beside the robot's own joint: outward, outward and half as wide, inward by 1 % of H0 at 40 degrees (ours)."""
    near_angle_deg: Annotated[float, Range(above=0.0, below=90.0)] = 40.0
    """Up to here the error is minimal (paper 000, section 5.5) [deg]."""
    far_angle_deg: Annotated[float, Range(above=0.0, below=90.0)] = 70.0
    """The extended range of the joints (paper 000, section 5.3) [deg]."""
    low_error_share: Annotated[float, Range(above=0.0, high=0.5)] = 0.01
    """Of H0: what counts as a low error (ours)."""
    growth: Annotated[float, Range(low=1.0, high=1000.0)] = 4.0
    """Far over near deviation that counts as growing rapidly, at least (ours; a quadratic alone gives 3)."""
    largest_pin_distance: Annotated[float, Range(above=0.0, high=0.5)] = 0.025
    """k up to which the map goes [m] (ours)."""
    largest_plate_to_pin: Annotated[float, Range(above=0.0, high=0.5)] = 0.012
    """d up to which the map goes [m] (ours)."""
    num_poses: Annotated[int, Range(100, 10_000_000)] = 20_000
    """Of the whole arm, by the closed form (ours)."""
    num_settled: Annotated[int, Range(1, 10_000)] = 16
    """Of the whole arm, in the physics, at the far angle's limit (ours)."""

    def __post_init__(self):
        near, far = self.near_angle_deg, self.far_angle_deg
        if near >= far:
            raise ValueError(f"near_angle_deg: got {near}, allowed: less than far_angle_deg = {far}")
        labels = [AS_DESCRIBED, *(variant.label for variant in self.variants)]
        if len(set(labels)) != len(labels):
            raise ValueError(
                f"variants: got the labels {labels[1:]}, allowed: all different, and none '{AS_DESCRIBED}'"
            )

    @property
    def angles(self) -> tuple[float, float]:
        """Near and far [rad]."""
        return float(np.radians(self.near_angle_deg)), float(np.radians(self.far_angle_deg))


@dataclasses.dataclass(frozen=True)
class JointStudy:
    """What was measured of one joint and of the arm made of it."""

    label: str
    robot: Robot
    near: float
    far: float
    """Deviations [m] at the two angles."""
    low_error_end: float
    """[rad], NaN beyond 89 degrees."""
    is_as_described: bool
    """Whether the path is that of the paper's section 5.5."""
    arm_near: ArmEffects
    arm_far: ArmEffects
    """Of bends up to each angle."""
    settled: SettledEffects
    """Of bends up to the far angle."""


def study_joints(
    robot: Robot, simulation: SettleConfig, config: DeviationConfig, seed: int, advance
) -> list[JointStudy]:
    """The robot's own joint and all variants, at the same bends.

    Args:
        advance: called with 1 after each joint.
    """
    height = home_height(robot)
    studies = []
    for label, arm in [(AS_DESCRIBED, robot), *((one.label, _arm_of(robot, one, height)) for one in config.variants)]:
        studies.append(_study(label, arm, simulation, config, seed))
        advance(1)
    return studies


def joint_map(robot: Robot, config: DeviationConfig) -> DeviationMap:
    """Deviations over k and d at the robot's height at home."""
    largest = (config.largest_pin_distance, min(config.largest_plate_to_pin, 0.49 * home_height(robot)))
    return deviation_map(largest, home_height(robot), config.angles, config.low_error_share, config.growth)


def metrics_of(
    robot: Robot, config: DeviationConfig, studies: Sequence[JointStudy], found: DeviationMap
) -> dict[str, Any]:
    """Everything measured, SI units and degrees where named, for `metrics.json`."""
    return {
        "verdict": verdict(robot, config, studies, found),
        "home_height": home_height(robot),
        "low_error": config.low_error_share * home_height(robot),
        "map": {
            "share_as_described": float(found.is_as_described.mean()),
            "share_inward_at_far_angle": float((found.far < 0.0).mean()),
            "largest_pin_distance_as_described": float(found.pin_distance[found.is_as_described.any(axis=1)].max(initial=0.0)),
        },
        "joints": {one.label: _joint_metrics(one) for one in studies},
    }  # fmt: skip


def verdict(robot: Robot, config: DeviationConfig, studies: Sequence[JointStudy], found: DeviationMap) -> str:
    """One paragraph in words, from the numbers."""
    near, far = config.near_angle_deg, config.far_angle_deg
    share = 100 * found.is_as_described.mean()
    without_offset = found.far[:, 0]
    outward = "outward for every k" if (without_offset[1:] > 0.0).all() else "not outward for every k"
    yes = [one.label for one in studies if one.is_as_described]
    own = studies[0]
    end = "beyond 89°" if np.isnan(own.low_error_end) else f"at {np.degrees(own.low_error_end):.0f}°"
    return (
        f"Section 5.5 (minimal up to {near:.0f}°, inward and growing rapidly beyond) holds on {share:.1f} % of the map of k and d; "
        f"with d = 0 the path is {outward}. Of the joints studied it holds for: {', '.join(yes) or 'none'}. "
        f"The robot's own joint deviates by {own.near / MM:+.3f} mm at {near:.0f}° and {own.far / MM:+.3f} mm at {far:.0f}°; "
        f"its low error (1/{1 / config.low_error_share:g} of H0 = {1e3 * home_height(robot):.1f} mm) ends {end}. "
        f"At the arm's tip that is {_millimetres(own.arm_far.tip_shift)} (median; largest {own.arm_far.tip_shift.max() / MM:.2f} mm)."
    )


def joint_table(studies: Sequence[JointStudy], config: DeviationConfig) -> Table:
    """One row a joint: its dimensions, its deviations, where the low error ends."""
    columns = (
        Column("joint"), Column("k", 2, "mm"), Column("d", 2, "mm"),
        Column(f"at {config.near_angle_deg:g}°", 3, "mm"), Column(f"at {config.far_angle_deg:g}°", 3, "mm"),
        Column("low error ends", 1, "°"), Column("as in §5.5"),
    )  # fmt: skip
    rows = tuple(
        (one.label, one.robot.config.joint.pin_distance / MM, one.robot.config.joint.plate_to_pin / MM,
         one.near / MM, one.far / MM, None if np.isnan(one.low_error_end) else np.degrees(one.low_error_end),
         "yes" if one.is_as_described else "no")
        for one in studies
    )  # fmt: skip
    return Table(
        columns,
        rows,
        note=f"low error: |H - H0| up to {100 * config.low_error_share:g} % of H0; – not exceeded up to 89°",
    )


def arm_table(studies: Sequence[JointStudy], config: DeviationConfig) -> Table:
    """Two rows a joint: tip, common part and tension over the workspace up to each angle."""
    columns = (
        Column("joint"), Column("bends to", 0, "°"),
        *(Column(f"tip shift, {name}", 2, "mm") for name in ("median", "p90", "max")),
        *(Column(f"common part, {name}", 2, "mm") for name in ("least", "most")),
        *(Column(f"tension, {name}", 1, "N") for name in ("least", "most")), Column("slack", 1, "%"),
    )  # fmt: skip
    rows = []
    for one in studies:
        for angle, arm in ((config.near_angle_deg, one.arm_near), (config.far_angle_deg, one.arm_far)):
            shift, common, tension = arm.tip_shift / MM, arm.common_part / MM, arm.held_tension
            rows.append(
                (one.label, angle, np.median(shift), np.quantile(shift, 0.9), shift.max(), common.min(), common.max(),
                 tension.min(), tension.max(), 100 * (tension < SLACK_TENSION).mean())
            )  # fmt: skip
    note = "tip shift: from the arm of constant H0 at the same cable lengths; tension: of elastic strands, held at the nominal bends"
    return Table(columns, tuple(rows), note=note)


def settled_table(studies: Sequence[JointStudy]) -> Table:
    """One row a joint: the same poses held and settled."""
    columns = (
        Column("joint"), Column("settled", 0), Column("of", 0),
        *(Column(name, 1, "N") for name in ("held, most", "settled, least", "settled, most")), Column("slack", 1, "%"),
        Column("closed form off by", 3, "N"), Column("bends lost, largest", 2, "°"),
    )  # fmt: skip
    return Table(columns, tuple(_settled_row(one) for one in studies), note=_SETTLED_NOTE)


_SETTLED_NOTE = (
    "closed form off by: largest difference of the elastic strands' tension at the settled bends from the physics'"
)


def _arm_of(robot: Robot, variant: JointVariant, height: float) -> Robot:
    length = closed_form.crossed_link_length(variant.pin_distance, variant.plate_to_pin, height)
    return arm_with_joint(robot, float(length), variant.pin_distance, variant.plate_to_pin)


def _study(label: str, robot: Robot, simulation: SettleConfig, config: DeviationConfig, seed: int) -> JointStudy:
    joint, height = robot.config.joint, home_height(robot)
    shape = (joint.pin_distance, joint.plate_to_pin, height)
    near, far = (float(closed_form.deviation(*shape, angle)) for angle in config.angles)
    arms = [effects_on_arm(robot, draw_limited_bends(robot, angle, config.num_poses, seed)) for angle in config.angles]
    settled = draw_limited_bends(robot, config.angles[1], config.num_settled, seed + 1)
    return JointStudy(
        label=label,
        robot=robot,
        near=near,
        far=far,
        low_error_end=closed_form.low_error_end(*shape, config.low_error_share),
        is_as_described=bool(closed_form.is_as_described(near, far, height, config.low_error_share, config.growth)),
        arm_near=arms[0],
        arm_far=arms[1],
        settled=settled_effects(robot, simulation, settled),
    )


def _joint_metrics(one: JointStudy) -> dict[str, Any]:
    joint, settled = one.robot.config.joint, _settled_row(one)
    return {
        "pin_distance": joint.pin_distance,
        "plate_to_pin": joint.plate_to_pin,
        "crossed_link_length": joint.crossed_link_length,
        "cancelling_plate_to_pin": _or_none(closed_form.cancelling_offset(joint.pin_distance, home_height(one.robot))),
        "deviation_near": one.near,
        "deviation_far": one.far,
        "low_error_end_deg": _or_none(float(np.degrees(one.low_error_end))),
        "is_as_described": one.is_as_described,
        "arm_near": _arm_metrics(one.arm_near),
        "arm_far": _arm_metrics(one.arm_far),
        "settled": dict(zip(_SETTLED_KEYS, settled[1:], strict=True)),
    }


_SETTLED_KEYS = (
    "num_settled", "num_poses", "held_tension_max", "tension_min", "tension_max", "slack_percent",
    "closed_form_error_max", "bend_lost_max_deg",
)  # fmt: skip


def _arm_metrics(arm: ArmEffects) -> dict[str, Any]:
    shift = arm.tip_shift
    return {
        "tip_shift": {
            "median": float(np.median(shift)),
            "p90": float(np.quantile(shift, 0.9)),
            "max": float(shift.max()),
        },
        "common_part": [float(arm.common_part.min()), float(arm.common_part.max())],
        "held_tension": [float(arm.held_tension.min()), float(arm.held_tension.max())],
        "held_slack_share": float((arm.held_tension < SLACK_TENSION).mean()),
    }


def _settled_row(one: JointStudy) -> tuple:
    """Cells of the settled table; None for what nothing settled leaves open."""
    good, count = one.settled.converged, len(one.settled.converged)
    if not good.any():
        return (one.label, 0, count, float(one.settled.held_tension.max()), None, None, None, None, None)
    tension = one.settled.settled_tension[good]
    lost = np.degrees(one.settled.commanded_angle - one.settled.settled_angle)[good]
    return (
        one.label, int(good.sum()), count, float(one.settled.held_tension[good].max()), float(tension.min()),
        float(tension.max()), float(100 * (tension < SLACK_TENSION).mean()),
        float(np.abs(one.settled.elastic_tension[good] - tension).max()), float(lost.max()),
    )  # fmt: skip


def _or_none(value: float) -> float | None:
    """JSON knows no NaN."""
    return None if np.isnan(value) else value


def _millimetres(values: np.ndarray) -> str:
    return f"{np.median(values) / MM:.2f} mm"
