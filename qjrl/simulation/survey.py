"""What an arm is and does: its counts, strokes and reach, and how it rests over its workspace."""

from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.geometry.pose import row_errors
from qjrl.robot import bends_from_cables, cable_strokes, forward_kinematics, strand_lengths
from qjrl.robot.kinds import verb
from qjrl.robot.quaternion_arm.description import QuaternionArm
from qjrl.robot.quaternion_arm.joint import angles_of_bends
from qjrl.robot.quaternion_arm.sampling import bends_from_unit_cube, planar_bends
from qjrl.robot.quaternion_arm.tip import tip_position
from qjrl.robot.verbs import is_at_strength
from qjrl.simulation.sampling import sample_rows
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SLACK_TENSION

# Poses of the closed form for reach and strand stretch; cheap, so many.
_NUM_KINEMATIC = 20_000
# A loop whose mean strand length grows by more when bent [m] loads its strands by more than the pretension usually is.
_MUCH_STRETCH = 0.002
# Bend of a whole segment [deg] at which the lines through its ends meet nowhere (paper 000, Eqs. 4-7).
_DIVERGENCE_DEG = 180.0


@configuration
class DescribeConfig:
    """Group `describe`."""

    num_poses: Annotated[int, Range(8, 1_000_000)] = 256
    """Low-discrepancy poses settled in the physics (ours)."""


def survey_kinematics(robot: QuaternionArm) -> dict[str, Any]:
    """Counts, lengths [m], strokes [m], travel times [s] and what the strands' common part does; closed form."""
    poses, bends = _many_poses(robot)
    home = forward_kinematics(robot, jnp.zeros((robot.num_segments, 2)))
    strokes = np.asarray(cable_strokes(robot))
    common = _common_parts(robot, bends)
    distance_home = np.linalg.norm(poses[:, :3] - np.asarray(home)[:3], axis=1)
    tips = np.concatenate([poses[:, :3], _planar_tips(robot)])
    return {
        "name": robot.name,
        "joint_model": robot.joint_model,
        "segments": list(robot.joints_per_segment),
        "degrees_of_freedom": 2 * robot.num_segments,
        "joints": robot.num_joints,
        "cables_and_motors": robot.num_cables,
        "strands": robot.num_strands,
        "length": float(home[2]),
        "bend_limit_deg": float(np.degrees(robot.bend_limit)),
        "cable_strokes": strokes.tolist(),
        "travel_times": (strokes / float(robot.motor_speed)).tolist(),
        "largest_reach": float(np.linalg.norm(tips, axis=1).max()),
        "workspace_radius": float(np.linalg.norm(tips[:, :2], axis=1).max()),
        "largest_distance_from_home": float(distance_home.max()),
        "median_distance_from_home": float(np.median(distance_home)),
        "strand_common_part": [float(common.min()), float(common.max())],
    }


def survey_physics(
    robot: QuaternionArm, simulation: SettleConfig, config: DescribeConfig, seed: int, advance=None
) -> dict[str, Any]:
    """Tension [N], slack, motor force [N], sag [m, rad] and what does not settle, over settled poses."""
    rows = sample_rows(robot, simulation, seed, 0, config.num_poses, advance)
    settled = rows["converged"]
    if not settled.any():
        return {"settled_share": 0.0}
    tension = rows["strand_tension"][settled]
    nominal = jax.vmap(lambda row: forward_kinematics(robot, bends_from_cables(robot, row)))(
        jnp.asarray(rows["cable_lengths"][settled])
    )
    position, orientation = row_errors(nominal, rows["pose"][settled])
    return {
        "settled_share": float(settled.mean()),
        "tension": [float(tension.min()), float(np.median(tension)), float(tension.max())],
        "slack_share": float((tension < SLACK_TENSION).mean()),
        "largest_motor_force": float(np.abs(verb(robot, "motor_force")(tension)).max()),
        "off_nominal": [float(np.median(position)), float(np.percentile(position, 90)), float(position.max())],
        "off_nominal_angle": [float(np.median(orientation)), float(orientation.max())],
        "largest_bend_deg": float(np.degrees(angles_of_bends(rows["bends"][settled]).max())),
    }


def warnings_about(robot: QuaternionArm, kinematics: dict[str, Any], physics: dict[str, Any]) -> list[str]:
    """What a builder of this arm should know, one line each: first what the physics says, then the description alone."""
    lines = []
    if physics["settled_share"] < 1.0:
        lines.append(
            f"{100 * (1 - physics['settled_share']):.1f} % of the poses never settle: more joint damping or stiffness"
        )
    if physics["settled_share"] > 0.0:
        lines += _warnings_of_physics(robot, physics)
    stretch = kinematics["strand_common_part"][1]
    if stretch > _MUCH_STRETCH:
        lines.append(
            f"loops stretch by {1e3 * stretch:.1f} mm when bent: this joint's k and d do not suit one motor a loop"
        )
    limit = robot.config.joint.bend_limit_deg
    for segment, num_joints in enumerate(robot.joints_per_segment, start=1):
        if num_joints * limit >= _DIVERGENCE_DEG:
            lines.append(
                f"segment {segment} bends to {num_joints} x {limit:g} = {num_joints * limit:g} deg: FABRIK's virtual "
                f"lengths diverge at {_DIVERGENCE_DEG:g} deg"
            )
    return lines


def _warnings_of_physics(robot: QuaternionArm, physics: dict[str, Any]) -> list[str]:
    """Of what has settled."""
    config, lines = robot.config, []
    if physics["slack_share"] > 0.0:
        lines.append(f"{100 * physics['slack_share']:.1f} % of the strands are slack: more pretension, or a tensioner")
    if is_at_strength(robot, physics["tension"][2]):
        lines.append(
            f"strand tension reaches {config.strands.strength:g} N, its strength: the strand would break, what it needs is "
            "more than this"
        )
    if physics["largest_motor_force"] > config.motors.force:
        lines.append(
            f"a motor would hold {physics['largest_motor_force']:.0f} N, above its {config.motors.force:.0f} N"
        )
    if physics["largest_bend_deg"] > config.joint.bend_limit_deg + 0.5 * config.joint.stop_margin_deg:
        lines.append(f"joints bend to {physics['largest_bend_deg']:.1f} deg under load: near the stop")
    return lines


def _many_poses(robot: QuaternionArm) -> tuple[np.ndarray, np.ndarray]:
    """Closed-form poses (n, 9) and bends (n, segments, 2) all over the feasible discs."""
    numbers = jax.random.uniform(jax.random.key(0), (_NUM_KINEMATIC, 2 * robot.num_segments))
    bends = jax.vmap(lambda row: bends_from_unit_cube(robot, row))(numbers)
    return np.asarray(jax.jit(jax.vmap(lambda row: forward_kinematics(robot, row)))(bends)), np.asarray(bends)


def _planar_tips(robot: QuaternionArm) -> np.ndarray:
    """Tips (n, 3) [m] of bends in one plane, among which are the farthest."""
    numbers = jax.random.uniform(jax.random.key(1), (_NUM_KINEMATIC, robot.num_segments))
    azimuth = jnp.zeros(())
    return np.asarray(jax.jit(jax.vmap(lambda row: tip_position(robot, planar_bends(robot, row, azimuth))))(numbers))


def _common_parts(robot: QuaternionArm, bends: np.ndarray) -> np.ndarray:
    """Half the sum of each loop's two strands relative to home (n, cables) [m]: what a motor cannot give."""
    lengths = jax.jit(jax.vmap(lambda row: strand_lengths(robot, row)))(jnp.asarray(bends))
    home = strand_lengths(robot, jnp.zeros((robot.num_segments, 2)))
    change = np.asarray(lengths - home)
    return (change[:, 0::2] + change[:, 1::2]) / 2.0
