"""What `describe` says of an arm: its radius against hand numbers, and its warnings."""

import numpy as np
import pytest
from arms import altered, arm_named, arm_of, made_up_mapping

from qjrl.report.description import description_text
from qjrl.simulation.survey import survey_kinematics, warnings_about

CALM = {
    "settled_share": 1.0, "slack_share": 0.0, "tension": [10.0, 15.0, 20.0], "largest_motor_force": 5.0,
    "largest_bend_deg": 30.0,
}  # fmt: skip
NO_STRETCH = {"strand_common_part": [0.0, 0.0]}
NOTHING_SETTLED = {"settled_share": 0.0}


@pytest.fixture(scope="module")
def one_joint():
    mapping = altered("qj_22", joints_per_segment=[1])
    mapping["cables"] |= {"hole_angles_deg": [[0, 90]], "names": [[1, 2]]}
    return arm_of(mapping)


@pytest.fixture(scope="module")
def found(one_joint):
    return survey_kinematics(one_joint)


def test_the_radius_of_one_joint_is_that_at_its_limit(one_joint, found):
    joint, limit = one_joint.config.joint, np.radians(one_joint.config.joint.bend_limit_deg)
    cosine = np.cos(limit / 2)
    height = (
        np.sqrt(joint.crossed_link_length**2 - (joint.pin_distance * cosine) ** 2) + 2 * joint.plate_to_pin * cosine
    )
    radius = height * np.sin(limit / 2) + one_joint.config.link_length * np.sin(limit)
    assert found["workspace_radius"] == pytest.approx(radius, rel=1e-12)
    assert found["largest_reach"] == pytest.approx(found["length"], rel=1e-3)
    assert found["workspace_radius"] < found["largest_reach"]


def test_the_radius_is_a_line_of_the_description(one_joint, found):
    text = description_text(one_joint, found | {"workspace_radius": 0.0567}, NOTHING_SETTLED, ["beware"])
    assert "workspace radius        57 mm from the base axis" in text and text.endswith("warning: beware")


@pytest.mark.parametrize(
    ("joints", "limit", "warned"), [([2, 2], 70.0, []), ([2, 3], 70.0, [2]), ([4, 5], 45.0, [1, 2]), ([4, 4], 44.9, [])]
)
def test_segments_that_bend_by_a_half_turn_are_named(joints, limit, warned):
    robot = arm_of(altered("qj_22", joints_per_segment=joints, joint__bend_limit_deg=limit))
    lines = warnings_about(robot, NO_STRETCH, CALM)
    assert [int(line.split()[1]) for line in lines if "diverge at 180 deg" in line] == warned
    assert len(lines) == len(warned)


def test_warnings_that_need_no_physics_are_kept_when_nothing_settles():
    robot = arm_of(made_up_mapping("rolling_312"))
    lines = warnings_about(robot, {"strand_common_part": [0.0, 0.005]}, NOTHING_SETTLED)
    assert [line.split()[0] for line in lines] == ["100.0", "loops", "segment"]


def test_the_shipped_arms_stay_below_a_half_turn():
    for name in ("qj_2222", "qj_huang_4332", "qj_22"):
        assert warnings_about(arm_named(name), NO_STRETCH, CALM) == []


def test_each_overload_of_the_physics_has_its_line():
    loaded = CALM | {"settled_share": 0.5, "slack_share": 0.1, "tension": [0.0, 15.0, 700.0], "largest_motor_force": 300.0,
                     "largest_bend_deg": 71.5}  # fmt: skip
    lines = warnings_about(arm_named("qj_2222"), NO_STRETCH, loaded)
    assert len(lines) == 5
    for line, words in zip(lines, ("never settle", "slack", "strength", "motor", "near the stop"), strict=True):
        assert words in line
