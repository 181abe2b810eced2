"""A robot's survey as lines a person reads: SI numbers become millimetres and degrees here."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from qjrl.robot.kinds import kind_of, verb
from qjrl.robot.verbs import Robot


def description_text(robot: Robot, kinematics: dict[str, Any], physics: dict[str, Any], warnings: Sequence[str]) -> str:
    """The table that `describe` prints.

    Args:
        kinematics, physics, warnings: of `simulation.survey`.
    """
    particulars, names = kind_of(robot).particulars, verb(robot, "cable_names")(robot)
    strokes = [
        f"{name.removeprefix('cable_')}: ±{1e3 * stroke:.0f}"
        for name, stroke in zip(names, kinematics["cable_strokes"], strict=True)
    ]
    travel = kinematics["travel_times"]
    rows = [
        ("robot", f"{kinematics['name']}, kind {kinematics['kind']}"),
        ("degrees of freedom", f"{kinematics['degrees_of_freedom']}"),
        ("cables = motors", f"{kinematics['cables_and_motors']}, {kinematics['strands']} strands"),
        ("length", f"{1e3 * kinematics['length']:.0f} mm at home"),
        ("reach of the tip", f"{1e3 * kinematics['largest_reach']:.0f} mm from the base"),
        ("workspace radius", f"{1e3 * kinematics['workspace_radius']:.0f} mm from the base axis"),
        ("tip from home", f"{1e3 * kinematics['median_distance_from_home']:.0f} mm median, "
                          f"{1e3 * kinematics['largest_distance_from_home']:.0f} mm largest"),
        ("cable strokes [mm]", ", ".join(strokes)),
        ("travel at motor speed", f"{min(travel):.1f} to {max(travel):.1f} s from home to full stroke"),
        *([] if particulars is None else particulars.rows(kinematics)),
        ("settled in the physics", f"{100 * physics['settled_share']:.1f} % of the poses"),
    ]  # fmt: skip
    if physics["settled_share"] > 0.0:
        least, middle, most = physics["tension"]
        median, p90, largest = (1e3 * value for value in physics["off_nominal"])
        rows += [
            ("off the closed form", f"{median:.1f} mm median, {p90:.1f} p90, {largest:.1f} largest; "
                                    f"{np.degrees(physics['off_nominal_angle'][0]):.2f}° median"),
            ("strand tension", f"{least:.1f} to {most:.1f} N, median {middle:.1f}; {100 * physics['slack_share']:.2f} % slack"),
            ("largest motor force", f"{physics['largest_motor_force']:.1f} N"),
        ]  # fmt: skip
    width = max(len(label) for label, _ in rows)
    lines = [f"{label:<{width}}  {text}" for label, text in rows]
    return "\n".join(lines + [f"warning: {line}" for line in warnings])
