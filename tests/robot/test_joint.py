import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import altered, joint_matrix
from hypothesis import given, settings
from hypothesis import strategies as st

from qjrl.geometry.pose import pose_from_frame
from qjrl.geometry.rotations import rotation_y, rotation_z
from qjrl.robot import bends_from_angles, bends_from_pose, load_robot, robot_from_mapping
from qjrl.robot.quaternion_arm.joint import bend_angle, half_direction, joint_height, joint_transform

ROLLING = load_robot("qj_2222")
SPHERICAL = load_robot("qj_2222_spherical")
OUTWARD = robot_from_mapping(
    altered(
        "qj_2222",
        joint__crossed_link_length=float(np.hypot(0.030, 0.020)),
        joint__pin_distance=0.020,
        joint__plate_to_pin=0.0,
    )
)
transform = jax.jit(joint_transform)
bend_of = jax.jit(bends_from_angles)
angle_of = jax.jit(bend_angle)
height_of = jax.jit(joint_height)
directions = st.floats(-np.pi, np.pi)
angles = st.floats(0.0, np.radians(179.0))


bend_of_pose = jax.jit(lambda position, rotation: bends_from_pose(pose_from_frame(position, rotation)))
bent_plane = jax.jit(lambda direction, angle: rotation_z(direction) @ rotation_y(angle) @ rotation_z(-direction))


def half_turn(axis: np.ndarray) -> np.ndarray:
    """Rot(axis, pi)."""
    return 2.0 * np.outer(axis, axis) - np.eye(3)


@settings(deadline=None, max_examples=50)
@given(directions, angles)
def test_the_transform_is_equation_2_with_its_off_diagonal_halved(direction, angle):
    bend = bend_of(direction, angle)
    for arm in (SPHERICAL, ROLLING):
        position, rotation = transform(arm, bend)
        expected = joint_matrix(arm, np.asarray(bend))
        np.testing.assert_allclose(rotation, expected[:3, :3], atol=1e-12)
        np.testing.assert_allclose(position, expected[:3, 3], atol=1e-14)


def test_equation_2_as_printed_is_no_rotation():
    printed = joint_matrix(SPHERICAL, np.array([0.3, 0.2]))[:3, :3]
    assert np.abs(printed.T @ printed - np.eye(3)).max() < 1e-15
    printed[0, 1] *= 2.0
    printed[1, 0] *= 2.0
    assert np.abs(printed.T @ printed - np.eye(3)).max() > 0.1


@settings(deadline=None, max_examples=50)
@given(directions, angles)
def test_the_rotation_is_two_half_turns_and_has_no_twist(direction, angle):
    bend = bend_of(direction, angle)
    _, rotation = transform(ROLLING, bend)
    np.testing.assert_allclose(
        rotation, half_turn(np.array([*bend, np.cos(angle / 2)])) @ half_turn(np.array([0, 0, 1.0])), atol=1e-14
    )
    np.testing.assert_allclose(rotation, bent_plane(direction, angle), atol=1e-14)
    assert rotation[0, 1] == rotation[1, 0]


@settings(deadline=None, max_examples=50)
@given(directions, angles)
def test_equation_1_inverts_the_transform(direction, angle):
    bend = bend_of(direction, angle)
    for arm in (ROLLING, SPHERICAL):
        position, rotation = transform(arm, bend)
        x, y, z = np.asarray(position)
        np.testing.assert_allclose(bend_of_pose(position, rotation), bend, atol=1e-14)
        assert abs(2.0 * np.arctan2(np.hypot(x, y), z) - angle) < 1e-12
    assert abs(float(angle_of(bend)) - angle) < 1e-12


@pytest.mark.parametrize(
    ("arm", "angle_deg", "deviation_mm"),
    [(OUTWARD, 40, 0.77), (OUTWARD, 70, 2.12), (ROLLING, 40, -0.01), (ROLLING, 70, -0.17), (SPHERICAL, 70, 0.0)],
)
def test_the_elliptical_deviation_has_the_specified_size(arm, angle_deg, deviation_mm):
    deviation = height_of(arm, bend_of(0.3, np.radians(angle_deg))) - height_of(arm, jnp.zeros(2))
    assert 1e3 * float(deviation) == pytest.approx(deviation_mm, abs=0.005)


@pytest.mark.parametrize("arm", [ROLLING, OUTWARD, SPHERICAL], ids=["rolling", "outward", "spherical"])
def test_the_joint_is_30_mm_high_at_home(arm):
    assert 1e3 * float(height_of(arm, jnp.zeros(2))) == pytest.approx(30.0, abs=0.005)


def denavit_hartenberg(length: float, twist: float, offset: float, turn: float) -> np.ndarray:
    c, s, ct, st_ = np.cos(turn), np.sin(turn), np.cos(twist), np.sin(twist)
    return np.array(
        [[c, -s * ct, s * st_, length * c], [s, c * ct, -c * st_, length * s], [0, st_, ct, offset], [0, 0, 0, 1]]
    )


@settings(deadline=None, max_examples=50)
@given(directions, angles)
def test_table_1_closes_on_the_rolling_closed_form(direction, angle):
    """Paper 000, Table 1, as printed, with r = k/2 and the joint variables of the antiparallelogram's middle limb."""
    joint, quarter = ROLLING.config.joint, np.pi / 2
    link, pins, offset = joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin
    crossing = np.arcsin(pins * np.cos(angle / 2) / link) - np.arcsin(pins / link)
    theta_1, theta_3, theta_4 = direction + quarter, angle / 2 + crossing, angle / 2 - crossing
    rows = [
        (0.0, quarter, offset, theta_1 + np.pi),
        (0.0, -quarter, pins / 2, quarter),
        (link, 0.0, 0.0, theta_3 + np.arcsin(pins / link)),
        (0.0, quarter, 0.0, theta_4 - np.arcsin(pins / link)),
        (0.0, quarter, pins / 2, quarter),
        (0.0, 0.0, offset, -theta_1),
    ]
    chain = np.linalg.multi_dot([denavit_hartenberg(*row) for row in rows])
    position, rotation = transform(ROLLING, bend_of(direction, angle))
    np.testing.assert_allclose(chain[:3, 3], position, atol=1e-15)
    np.testing.assert_allclose(chain[:3, :3], rotation, atol=1e-14)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_derivatives_at_home_and_beyond_a_half_turn_are_finite(dtype):
    arm = jax.tree.map(lambda leaf: leaf.astype(dtype), ROLLING)

    def function(bend):
        return (bend_angle(bend), half_direction(bend), joint_height(arm, bend))

    for bend in (jnp.zeros(2, dtype), jnp.array([1.2, 0.3], dtype)):
        for values in jax.jit(lambda x: (function(x), jax.jacfwd(function)(x), jax.jacrev(function)(x)))(bend):
            for value in values:
                assert value.dtype == dtype
                assert np.isfinite(value).all()
