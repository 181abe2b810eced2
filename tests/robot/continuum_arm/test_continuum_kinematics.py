"""The nominal continuum arm against what the paper prints, plain geometry and itself; and the paper's errata, each proven."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from continuum import arm, random_bends, unlike
from scipy.linalg import expm

from qjrl.config import ConfigError
from qjrl.robot import bends_from_cables, cable_lengths, forward_kinematics, load_robot
from qjrl.robot.continuum_arm.kinematics import frames
from qjrl.robot.continuum_arm.segment import segment_pose
from qjrl.robot.kinds import verb
from qjrl.robot.tip import tip_by_differentiation

DATA = Path(__file__).parents[3] / "data" / "paper002"
JOINTS = np.genfromtxt(DATA / "table1_joints.csv", delimiter=",", names=True)
POSES = np.genfromtxt(DATA / "table1_poses.csv", delimiter=",", skip_header=1)[:, 1:].reshape(5, 3, 4)
CABLES = np.stack([JOINTS[f"cable_{number}_mm"] for number in (1, 2, 3, 4)], axis=1).reshape(5, 4, 4)
ALPHA, THETA = (JOINTS[name].reshape(5, 4) for name in ("alpha_rad", "theta_rad"))
MISPRINT = (3, 2)
"""Case 4, segment 3: the sign of alpha."""
LENGTH, RADIUS = 120.0, 70.0
ARMS = {"continuum_4": load_robot("continuum_4"), "unlike": unlike()}


def the_example():
    """The arm of Table 1."""
    return arm(segments__anchor_radii=[RADIUS / 1000.0] * 4)


def poses_of(bends):
    robot = the_example()
    return np.asarray(jax.vmap(lambda row: forward_kinematics(robot, row))(jnp.asarray(bends)))


def rotations(poses):
    x, y = poses[:, 3:6], poses[:, 6:9]
    return np.stack([x, y, np.cross(x, y)], axis=2)


def bends_of_the_cables():
    robot = the_example()
    lengths = (CABLES / 1000.0 - 0.12).reshape(5, 16)
    return np.asarray(jax.vmap(lambda row: bends_from_cables(robot, row))(jnp.asarray(lengths)))


def test_table_1_comes_out_to_its_printed_digits():
    bends = bends_of_the_cables()
    angles = np.linalg.norm(bends, axis=2)
    np.testing.assert_allclose(angles, THETA, atol=6e-5)
    alpha = np.arctan2(bends[..., 1], bends[..., 0])
    printed = ALPHA.copy()
    printed[MISPRINT] *= -1.0
    np.testing.assert_allclose(alpha[1:], printed[1:], atol=6e-5)  # case 1 is straight: alpha means nothing
    poses = poses_of(bends)
    np.testing.assert_allclose(1e3 * poses[:, :3], POSES[:, :, 3], atol=6e-5)
    np.testing.assert_allclose(rotations(poses), POSES[:, :, :3], atol=6e-5)


def test_case_4_has_the_pose_of_the_other_sign_of_its_printed_alpha():
    off = 1e3 * poses_of(THETA[..., None] * np.stack([np.cos(ALPHA), np.sin(ALPHA)], axis=2))[:, :3] - POSES[:, :, 3]
    assert 17.0 < np.linalg.norm(off[3]) < 19.0
    assert np.linalg.norm(np.delete(off, 3, axis=0), axis=1).max() < 0.05  # the others, rounded to four digits


@pytest.mark.parametrize(
    ("arctangent", "millimetres"),
    [
        (np.arctan2, [12.8, 22.3, 128.8, 136.2]),
        (lambda y, x: np.arctan(y / np.where(x == 0.0, 1e-12, x)), [48.4, 93.6, 170.8, 94.3]),
    ],
    ids=["of two arguments", "as printed"],
)
def test_equation_4_misses_the_poses_with_the_printed_sign_whatever_the_arctangent(arctangent, millimetres):
    difference = CABLES[..., 3] - CABLES[..., 1], CABLES[..., 2] - CABLES[..., 0]  # l4 - l2, l3 - l1
    alpha, theta = arctangent(*difference), 2.0 * np.arcsin(np.hypot(*difference) / (4.0 * RADIUS))
    bends = theta[..., None] * np.stack([np.cos(alpha), np.sin(alpha)], axis=2)
    off = np.linalg.norm(1e3 * poses_of(bends)[1:, :3] - POSES[1:, :, 3], axis=1)
    np.testing.assert_allclose(off, millimetres, atol=0.06)


def exponential(alpha, theta, third):
    """exp of the screw of Eq. 11 with `third` in place of its third component, as a frame (4, 4) [mm]."""
    omega = np.array([-np.sin(alpha), np.cos(alpha), 0.0])
    v = LENGTH * np.array([-0.5 * np.cos(alpha), -0.5 * np.sin(alpha), third])
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0.0, 0.0, omega[1]], [0.0, 0.0, -omega[0]], [-omega[1], omega[0], 0.0]]
    twist[:3, 3] = v
    at_home = np.eye(4)
    at_home[2, 3] = LENGTH
    return expm(twist * theta) @ at_home


@pytest.mark.parametrize("is_mended", [True, False])
def test_equation_11_wants_the_cotangent_of_half_the_angle(is_mended):
    bends, off = bends_of_the_cables(), []
    for case in range(1, 5):
        frame = np.eye(4)
        for bend in bends[case]:
            alpha, theta = np.arctan2(bend[1], bend[0]), np.linalg.norm(bend)
            third = 1.0 / theta - 0.5 / np.tan(theta / 2.0 if is_mended else 1.0 / theta)
            frame = frame @ exponential(alpha, theta, third)
        off.append(np.linalg.norm(frame[:3, 3] - POSES[case, :, 3]))
    assert max(off) < 1e-4 if is_mended else min(off) > 100.0


@pytest.mark.parametrize("name", ARMS)
def test_cables_are_the_distances_between_their_anchors(name):
    robot = ARMS[name]
    for bends in random_bends(robot, 5):
        ends, lengths = np.asarray(frames(robot, jnp.asarray(bends))), []
        base = np.array([0.0, 0, 0, 1, 0, 0, 0, 1, 0])
        for segment, (below, above) in enumerate(zip([base, *ends[:-1]], ends, strict=True)):
            for direction in np.asarray(robot.anchor_directions)[segment]:
                x, y = np.asarray(robot.anchor_radii)[segment] * direction
                low, high = (pose[:3] + x * pose[3:6] + y * pose[6:9] for pose in (below, above))
                lengths.append(np.linalg.norm(high - low) - np.asarray(robot.segment_lengths)[segment])
        np.testing.assert_allclose(cable_lengths(robot, jnp.asarray(bends)), lengths, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-6, 1e-3, 1.0])
def test_bends_come_back_from_their_cables_whatever_these_have_in_common(name, scale):
    robot = ARMS[name]
    common = np.repeat(np.linspace(-0.004, 0.003, robot.num_segments), robot.cables_per_segment)
    for bends in scale * random_bends(robot, 5, seed=1):
        lengths = cable_lengths(robot, jnp.asarray(bends)) + common
        np.testing.assert_allclose(bends_from_cables(robot, lengths), bends, atol=1e-12)


@pytest.mark.parametrize(
    "bend", [(0.0, 0.0), (1e-9, 0.0), (0.05, 0.0), (0.09, 0.05), (0.1, 0.01), (-1.1, 0.3), (2.0, 2.0)]
)
def test_a_segment_is_the_exponential_of_its_mended_screw(bend):
    alpha, theta = np.arctan2(bend[1], bend[0]), np.linalg.norm(bend)
    third = 1.0 / theta - 0.5 / np.tan(theta / 2.0) if theta > 1e-6 else theta / 12.0
    expected = exponential(alpha, theta, third)
    position, rotation = segment_pose(jnp.float64(0.12), jnp.array(bend))
    np.testing.assert_allclose(position, expected[:3, 3] / 1000.0, atol=1e-9 if theta < 1e-6 else 1e-13)
    np.testing.assert_allclose(rotation, expected[:3, :3], atol=1e-12)


@pytest.mark.parametrize("robot", ARMS.values(), ids=ARMS)
def test_the_jacobian_segment_by_segment_is_that_of_differentiation(robot):
    for scale in (1.0, 1e-7, 0.0):
        rows = jnp.asarray(scale * random_bends(robot, 3, seed=2).reshape(3, -1).T)
        found = verb(robot, "tip")(robot, rows)
        expected = tip_by_differentiation(
            lambda row: forward_kinematics(robot, row.reshape(robot.num_segments, 2)), rows
        )
        for name in ("position", "rotation", "velocity", "angular_velocity"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)


def test_the_straight_arm_moves_smoothly():
    """Slopes at zero are those between two small bends, in both precisions."""
    robot = ARMS["continuum_4"]
    for dtype, step, tolerance in ((jnp.float64, 1e-5, 1e-9), (jnp.float32, 1e-2, 1e-4)):
        zero = jnp.zeros(8, dtype)
        tip = tip_by_differentiation(lambda row: forward_kinematics(robot, row.reshape(4, 2)), zero)
        assert tip.velocity.dtype == dtype and bool(jnp.isfinite(tip.velocity).all())
        ahead, behind = (forward_kinematics(robot, (zero.at[0].set(sign * step)).reshape(4, 2)) for sign in (1, -1))
        np.testing.assert_allclose((ahead - behind)[:3] / (2.0 * step), tip.velocity[:, 0], atol=tolerance)


def test_strokes_are_the_largest_lengths_within_the_limits():
    robot = ARMS["unlike"]
    strokes = np.asarray(verb(robot, "cable_strokes")(robot))
    lengths = [np.abs(cable_lengths(robot, jnp.asarray(bends))) for bends in random_bends(robot, 3000)]
    share = np.max(lengths, axis=0) / strokes
    assert share.max() <= 1.0 + 1e-12 and share.min() > 0.95


def test_a_tip_at_a_distance_is_at_it():
    robot = ARMS["continuum_4"]
    home = forward_kinematics(robot, jnp.zeros((4, 2)))
    for seed in range(3):
        bends = verb(robot, "at_distance")(robot, jax.random.key(seed), jnp.float64(0.1))
        assert abs(np.linalg.norm(forward_kinematics(robot, bends)[:3] - home[:3]) - 0.1) < 1e-9


@pytest.mark.parametrize(
    ("bends", "message"),
    [
        (
            np.full((4, 2), 30.0),
            r"segment 0 .* got a bend of 42.43 rad, allowed: below pi; in degrees\? divide by 57.3",
        ),
        (np.zeros((3, 2)), r"configuration: got the shape \(3, 2\), allowed: \(4, 2\)"),
        (np.full((4, 2), np.nan), "configuration: got nan at"),
    ],
)
def test_bends_that_nothing_can_have_are_refused(bends, message):
    with pytest.raises(ConfigError, match=message):
        forward_kinematics(ARMS["continuum_4"], bends)


@pytest.mark.parametrize(
    ("lengths", "message"),
    [
        (np.zeros(15), r"lengths: got the shape \(15,\), allowed: \(16,\)"),
        (np.full(16, 120.0), r"cable_1: got 120 m, allowed: up to 1.\d+ m, .*in millimetres\? divide by 1,000"),
    ],
)
def test_lengths_that_no_cable_can_have_are_refused(lengths, message):
    with pytest.raises(ConfigError, match=message):
        bends_from_cables(ARMS["continuum_4"], lengths)
