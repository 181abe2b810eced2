"""What a robot is and does: its counts, strokes and reach, and how it rests over its workspace."""

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.geometry.pose import row_errors
from qjrl.robot import cable_strokes, forward_kinematics
from qjrl.robot.kinds import kind_of, num_coordinates, verb
from qjrl.robot.verbs import Robot, configuration_from_cables, is_at_strength
from qjrl.simulation.sampling import sample_rows
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import SLACK_TENSION

# Poses of the closed form for reach; cheap, so many.
_NUM_KINEMATIC = 20_000


@configuration
class DescribeConfig:
    """Group `describe`."""

    num_poses: Annotated[int, Range(8, 1_000_000)] = 256
    """Low-discrepancy poses settled in the physics (ours)."""


def survey_kinematics(robot: Robot) -> dict[str, Any]:
    """Counts, lengths [m], strokes [m], travel times [s] and what the robot's kind adds; closed form."""
    kind = kind_of(robot)
    configurations, poses = _many(robot, kind.from_unit_cube, seed=0)
    home = np.asarray(forward_kinematics(robot, kind.home(robot)))[:3]
    strokes = np.asarray(cable_strokes(robot))
    distance_home = np.linalg.norm(poses[:, :3] - home, axis=1)
    tips = poses[:, :3]
    if kind.particulars is not None:
        tips = np.concatenate([tips, _many(robot, kind.particulars.extreme, seed=1)[1][:, :3]])
    numbers = {
        "name": robot.name,
        "kind": robot.kind,
        "degrees_of_freedom": num_coordinates(robot),
        "cables_and_motors": robot.num_cables,
        "strands": robot.num_strands,
        "length": float(np.linalg.norm(home)),
        "cable_strokes": strokes.tolist(),
        "travel_times": (strokes / float(robot.motor_speed)).tolist(),
        "largest_reach": float(np.linalg.norm(tips, axis=1).max()),
        "workspace_radius": float(np.linalg.norm(tips[:, :2], axis=1).max()),
        "largest_distance_from_home": float(distance_home.max()),
        "median_distance_from_home": float(np.median(distance_home)),
    }
    return numbers | ({} if kind.particulars is None else kind.particulars.own(robot, configurations))


def survey_physics(
    robot: Robot, simulation: SettleConfig, config: DescribeConfig, seed: int, advance=None
) -> dict[str, Any]:
    """Tension [N], slack, motor force [N], sag [m, rad] and what does not settle, over settled poses."""
    rows = sample_rows(robot, simulation, seed, 0, config.num_poses, advance)
    settled = {name: values[rows["converged"]] for name, values in rows.items()}
    if not rows["converged"].any():
        return {"settled_share": 0.0}
    tension = settled["strand_tension"]
    nominal = jax.vmap(lambda row: forward_kinematics(robot, configuration_from_cables(robot, row)))(
        jnp.asarray(settled["cable_lengths"])
    )
    position, orientation = row_errors(nominal, settled["pose"])
    numbers = {
        "settled_share": float(rows["converged"].mean()),
        "tension": [float(tension.min()), float(np.median(tension)), float(tension.max())],
        "slack_share": float((tension < SLACK_TENSION).mean()),
        "largest_motor_force": float(np.abs(verb(robot, "motor_force")(robot, tension)).max()),
        "off_nominal": [float(np.median(position)), float(np.percentile(position, 90)), float(position.max())],
        "off_nominal_angle": [float(np.median(orientation)), float(orientation.max())],
    }
    particulars = kind_of(robot).particulars
    return numbers | ({} if particulars is None else particulars.under_load(robot, settled))


def warnings_about(robot: Robot, kinematics: dict[str, Any], physics: dict[str, Any]) -> list[str]:
    """What a builder of this robot should know, one line each: first what the physics says, then the description alone."""
    lines = []
    if physics["settled_share"] < 1.0:
        lines.append(
            f"{100 * (1 - physics['settled_share']):.1f} % of the poses never settle: more joint damping or stiffness"
        )
    if physics["settled_share"] > 0.0:
        lines += _warnings_of_physics(robot, physics)
    particulars = kind_of(robot).particulars
    return lines + ([] if particulars is None else particulars.warnings(robot, kinematics | physics))


def _warnings_of_physics(robot: Robot, physics: dict[str, Any]) -> list[str]:
    """Of what has settled."""
    lines, largest, force = [], physics["tension"][2], float(robot.motor_force)
    if physics["slack_share"] > 0.0:
        lines.append(f"{100 * physics['slack_share']:.1f} % of the strands are slack: more pretension, or a tensioner")
    if is_at_strength(robot, largest):
        lines.append(
            f"strand tension reaches {largest:g} N, its strength: the strand would break, what it needs is more than this"
        )
    if physics["largest_motor_force"] > force:
        lines.append(f"a motor would hold {physics['largest_motor_force']:.0f} N, above its {force:.0f} N")
    return lines


def _many(robot: Robot, configuration_of: Callable[..., jax.Array], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Configurations (n, ...) of random numbers in [0, 1), and their closed-form poses (n, 9)."""
    numbers = jax.random.uniform(jax.random.key(seed), (_NUM_KINEMATIC, num_coordinates(robot)))
    configurations = jax.jit(jax.vmap(partial(configuration_of, robot)))(numbers)
    return np.asarray(configurations), np.asarray(jax.jit(jax.vmap(partial(forward_kinematics, robot)))(configurations))
