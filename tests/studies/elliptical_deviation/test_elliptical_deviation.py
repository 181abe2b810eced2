"""The joint's path beside the circle, and what it does to arms: hand numbers, exact properties, the physics."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from arms import over_rows, random_bends

from qjrl import artifacts, pipeline
from qjrl.config import as_mapping, conf_folder, read_yaml
from qjrl.robot import cable_lengths, forward_kinematics, load_robot
from qjrl.simulation import SettleConfig
from qjrl.studies.elliptical_deviation.closed_form import (
    cancelling_offset,
    crossed_link_length,
    deviation,
    deviation_map,
    is_as_described,
    low_error_end,
)
from qjrl.studies.elliptical_deviation.effects import (
    arm_with_joint,
    draw_limited_bends,
    effects_on_arm,
    home_height,
    strand_tension,
)
from qjrl.studies.elliptical_deviation.measure import AS_DESCRIBED, DeviationConfig, JointVariant

H0 = 0.030
NEAR, FAR = np.radians(40.0), np.radians(70.0)


@pytest.mark.parametrize(
    ("pins", "offset", "near_mm", "far_mm"),
    [(0.020, 0.0, 0.77, 2.12), (0.014, 0.0046, -0.011, -0.168), (0.0, 0.0, 0.0, 0.0)],
)
def test_deviations_are_the_known_ones(pins, offset, near_mm, far_mm):
    found = 1e3 * deviation(pins, offset, H0, np.array([0.0, NEAR, FAR, -FAR]))
    assert found == pytest.approx([0.0, near_mm, far_mm, far_mm], abs=0.005)


def test_the_path_is_that_of_the_crossed_links():
    """Independent: the coupler of an antiparallelogram, pins at +-k/2, crossed links of length l, tilted by theta."""
    pins, offset, angle = 0.02, 0.003, np.radians(55.0)
    length = crossed_link_length(pins, offset, H0)
    normal, along = np.array([np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), -np.sin(angle)])
    height = H0 + deviation(pins, offset, H0, angle)
    centre = height * np.array([np.sin(angle / 2), np.cos(angle / 2)])
    for side in (-0.5, 0.5):
        lower = np.array([side * pins, offset])
        upper = centre - offset * normal - side * pins * along
        assert np.linalg.norm(upper - lower) == pytest.approx(length, abs=1e-12)


def test_the_quadratic_part_vanishes_at_the_cancelling_offset():
    pins = 0.012
    offset = cancelling_offset(pins, H0)
    assert offset == pytest.approx(pins**2 / (2 * (H0 - 2 * offset)))
    small, double = deviation(pins, offset, H0, np.array([0.05, 0.1]))
    assert small < 0 and double / small == pytest.approx(16.0, rel=0.01)  # inward, of fourth order
    assert np.isnan(cancelling_offset(0.016, H0))


def test_low_error_ends_where_the_deviation_leaves_the_band():
    end = low_error_end(0.020, 0.0, H0, 0.01)
    assert abs(deviation(0.020, 0.0, H0, end)) == pytest.approx(0.01 * H0, rel=1e-4)
    assert np.isnan(low_error_end(0.0, 0.0, H0, 0.01))


def test_the_map_agrees_with_the_closed_form_and_is_outward_without_offset():
    found = deviation_map((0.025, 0.012), H0, (NEAR, FAR), 0.01, 4.0, resolution=9)
    row, column = 5, 1
    shape = (found.pin_distance[row], found.plate_to_pin[column], H0)
    assert found.near[row, column] == pytest.approx(deviation(*shape, NEAR))
    assert found.low_error_end[row, column] == pytest.approx(low_error_end(*shape, 0.01), nan_ok=True)
    assert (found.far[1:, 0] > 0.0).all() and (found.far[0, 1:] < 0.0).all()
    described = is_as_described(found.near, found.far, H0, 0.01, 4.0)
    np.testing.assert_array_equal(found.is_as_described, described)


@pytest.fixture(scope="module")
def robot():
    return load_robot("qj_22")


def test_spherical_joints_shift_nothing_and_stretch_nothing(robot):
    spherical = arm_with_joint(robot, home_height(robot), 0.0, 0.0)
    effects = effects_on_arm(spherical, random_bends(spherical, 30))
    assert effects.tip_shift.max() < 1e-15 and np.abs(effects.common_part).max() < 1e-15
    np.testing.assert_allclose(effects.held_tension, robot.config.strands.pretension, rtol=1e-9)


def test_effects_are_those_of_kinematics_and_of_springs(robot):
    arm = arm_with_joint(robot, float(crossed_link_length(0.02, 0.0, H0)), 0.02, 0.0)
    bends = random_bends(arm, 20)
    effects = effects_on_arm(arm, bends)
    spherical = arm_with_joint(arm, H0, 0.0, 0.0)
    tips = [over_rows(forward_kinematics, one, bends)[:, :3] for one in (arm, spherical)]
    np.testing.assert_allclose(effects.tip_shift, np.linalg.norm(tips[0] - tips[1], axis=1), atol=1e-12)
    angles = 2 * np.arcsin(np.linalg.norm(bends, axis=2))
    per_segment = np.array(arm.joints_per_segment) * deviation(0.02, 0.0, H0, angles)
    np.testing.assert_allclose(effects.common_part[:, ::2], np.cumsum(per_segment, axis=1), atol=1e-12)
    springs = arm.config.strands.pretension + arm.config.strands.stiffness * np.repeat(effects.common_part, 2, axis=1)
    np.testing.assert_allclose(effects.held_tension, springs, rtol=1e-9)  # outward: never slack


def test_a_strand_pulls_and_never_pushes(robot):
    slack = strand_tension(robot, jnp.zeros((2, 2)), jnp.full(robot.num_cables, 0.01))
    assert np.asarray(slack)[0] == 0.0 and np.asarray(slack)[1] > 100.0


def test_bends_stay_within_their_own_limit(robot):
    bends = draw_limited_bends(robot, 0.3, 200, 0)
    largest = 2 * np.arcsin(np.linalg.norm(bends, axis=2).max())
    assert 0.29 < largest <= 0.3


@pytest.mark.slow
def test_the_stage_settles_what_the_closed_form_says(tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "STAGES", {"elliptical_deviation": pipeline.STAGES["elliptical_deviation"]})
    study = DeviationConfig((JointVariant("wide", 0.014, 0.0),), num_poses=200, num_settled=3)
    tree = {
        "name": "tiny", "seed": 0, "stages": ["elliptical_deviation"], "elliptical_deviation": as_mapping(study),
        "robot": read_yaml(conf_folder() / "robot" / "qj_22.yaml"), "simulation": as_mapping(SettleConfig(batch_size=4)),
    }  # fmt: skip
    pipeline.run(pipeline.selected(tree), pipeline.build_configs(tree), tmp_path)
    metrics = artifacts.load(tmp_path / "elliptical_deviation" / "metrics.json")
    assert metrics["joints"].keys() == {AS_DESCRIBED, "wide"}
    for joint in metrics["joints"].values():
        assert joint["settled"]["num_settled"] == 3
        assert joint["settled"]["closed_form_error_max"] < 0.1  # N, of tens
    assert (
        metrics["joints"]["wide"]["settled"]["tension_max"] > metrics["joints"][AS_DESCRIBED]["settled"]["tension_max"]
    )
    assert len(list((tmp_path / "elliptical_deviation").glob("*.png"))) == 5


def test_angles_and_labels_are_checked():
    one = JointVariant("a", 0.01, 0.0)
    with pytest.raises(ValueError, match="near_angle_deg: got 70"):
        DeviationConfig((one,), near_angle_deg=70.0)
    with pytest.raises(ValueError, match="all different"):
        DeviationConfig((one, dataclasses.replace(one, pin_distance=0.02)))


def test_same_cables_same_bends_whatever_the_joint(robot):
    other = arm_with_joint(robot, float(crossed_link_length(0.02, 0.0, H0)), 0.02, 0.0)
    bends = random_bends(robot, 10)
    np.testing.assert_allclose(
        over_rows(cable_lengths, robot, bends), over_rows(cable_lengths, other, bends), atol=1e-15
    )
