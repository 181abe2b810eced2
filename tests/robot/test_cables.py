import jax.numpy as jnp
import numpy as np
import pytest
from arms import ARMS, arm_named, joint_matrix, over_rows, random_bends

from qjrl.robot import (
    bends_from_angles,
    bends_from_cables,
    cable_lengths,
    cable_strokes,
    strand_commands,
    strand_lengths,
)
from qjrl.robot.quaternion_arm.cables import cable_matrix, common_lengths

ARM = arm_named("qj_2222")


def strands_by_geometry(arm, bends: np.ndarray) -> np.ndarray:
    """Distances between the holes of facing plates, moved by each joint's transform, added up along every strand."""
    cables = [angle for pair in arm.config.cables.hole_angles_deg for angle in pair]
    lengths = []
    for cable, hole_angle in enumerate(cables):
        for angle in np.radians([hole_angle, hole_angle + 180.0]):
            hole = arm.config.cables.hole_circle_diameter / 2.0 * np.array([np.cos(angle), np.sin(angle), 0.0, 0.0])
            hole[3] = 1.0
            total = 0.0
            for segment in range(cable // 2 + 1):
                across = joint_matrix(arm, bends[segment]) @ hole - hole
                total += arm.joints_per_segment[segment] * np.linalg.norm(across)
            lengths.append(total)
    return np.array(lengths)


@pytest.mark.parametrize("name", ARMS)
def test_strand_and_cable_lengths_are_the_distances_between_the_holes(name):
    arm = arm_named(name)
    rows = random_bends(arm, 10)
    strands = np.stack([strands_by_geometry(arm, bends) for bends in rows])
    np.testing.assert_allclose(over_rows(strand_lengths, arm, rows), strands, atol=1e-15)
    np.testing.assert_allclose(
        over_rows(cable_lengths, arm, rows), (strands[:, 0::2] - strands[:, 1::2]) / 2, atol=1e-15
    )
    np.testing.assert_allclose(
        over_rows(common_lengths, arm, rows), (strands[:, 0::2] + strands[:, 1::2]) / 2, atol=1e-15
    )


@pytest.mark.parametrize("name", ARMS)
def test_bends_come_back_from_cable_lengths(name):
    arm = arm_named(name)
    bends = random_bends(arm, 50)
    lengths = over_rows(cable_lengths, arm, bends)
    np.testing.assert_allclose(over_rows(bends_from_cables, arm, lengths), bends, atol=1e-13)


def test_the_cable_map_is_linear_zero_at_home_and_well_conditioned():
    matrix = np.asarray(cable_matrix(ARM))
    np.testing.assert_array_equal(cable_lengths(ARM, jnp.zeros((4, 2))), 0.0)
    assert np.linalg.cond(matrix) == pytest.approx(5.4, abs=0.05)
    np.testing.assert_array_equal(matrix[:2, 2:], 0.0)  # the first segment's cables feel the first segment alone


def test_a_bend_towards_a_hole_pulls_its_cable_in_by_the_paper_s_own_segment_term():
    """Eq. 16 for segment 1: |l| = m D cos(beta - phi) sin(theta/2); towards its hole the cable gets shorter."""
    angle, direction = np.radians(70.0), np.radians(25.0)
    bends = jnp.zeros((4, 2)).at[0].set(bends_from_angles(jnp.asarray(direction), jnp.asarray(angle)))
    own = 2 * 0.031 * np.sin(angle / 2.0) * np.array([np.cos(-direction), np.cos(np.pi / 2 - direction)])
    np.testing.assert_allclose(cable_lengths(ARM, bends)[:2], -own, atol=1e-15)


def test_strokes_are_the_paper_s_71_mm_on_the_first_segment_and_bound_all_bends():
    strokes = np.asarray(cable_strokes(ARM))
    assert 2e3 * strokes[0] == pytest.approx(71.0, abs=0.2)
    assert 1e3 * strokes[-1] == pytest.approx(142.0, abs=0.5)
    lengths = over_rows(cable_lengths, ARM, random_bends(ARM, 500))
    assert (np.abs(lengths) <= strokes).all()
    towards = np.radians([0, 0, 45, 45, 22.5, 22.5, 67.5, 67.5][-2])
    straight = bends_from_angles(jnp.full(4, towards), jnp.full(4, ARM.bend_limit))
    assert abs(float(cable_lengths(ARM, straight)[-2])) == pytest.approx(strokes[-2], rel=1e-12)


def test_the_common_part_is_nothing_for_the_spherical_and_small_for_the_rolling_arm():
    spherical = arm_named("qj_2222_spherical")
    home = np.zeros((1, 4, 2))
    change = over_rows(common_lengths, spherical, random_bends(spherical, 200)) - over_rows(
        common_lengths, spherical, home
    )
    assert np.abs(change).max() < 1e-16
    limit = bends_from_angles(jnp.zeros(4), jnp.full(4, ARM.bend_limit))
    change = common_lengths(ARM, limit) - common_lengths(ARM, jnp.zeros((4, 2)))
    assert 1e3 * np.abs(change).max() == pytest.approx(1.34, abs=0.01)


def test_commands_give_every_strand_its_pretension_at_home():
    commands = strand_commands(ARM, jnp.zeros(8))
    stretch = strand_lengths(ARM, jnp.zeros((4, 2))) - commands
    np.testing.assert_allclose(stretch * ARM.strand_stiffness, 15.0, rtol=1e-9)


def test_a_command_pays_out_one_strand_of_a_loop_and_takes_in_the_other():
    lengths = jnp.zeros(8).at[3].set(0.004)
    change = strand_commands(ARM, lengths) - strand_commands(ARM, jnp.zeros(8))
    np.testing.assert_allclose(change.reshape(8, 2)[3], [0.004, -0.004], atol=1e-17)
    assert np.count_nonzero(np.abs(change) > 1e-15) == 2


def test_a_tensioner_is_in_series_with_the_strand():
    assert float(arm_named("rolling_312").strand_stiffness) == pytest.approx(1.0 / (1.0 / 20000.0 + 1.0 / 60000.0))
