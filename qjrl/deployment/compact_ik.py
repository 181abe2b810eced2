"""Inverse kinematics of a bounded cost for a controller: the package's descent from a few stored starts.

Every start descends on the closed form first, which costs next to nothing, and its end on the model. Only elementary
operations (see `levenberg_marquardt`): an exported file must run on any platform.
"""

import math
from typing import Annotated

import jax
import jax.numpy as jnp

from qjrl.config import Range, configuration
from qjrl.deployment.functions import Outputs, SolveFunction
from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.pose_model import PoseFunction
from qjrl.robot.verbs import Robot, forward_kinematics
from qjrl.solvers.levenberg_marquardt import Descent, DescentConfig, descend
from qjrl.solvers.model_tip import lengths_of, tip_function


@configuration
class CompactIKConfig:
    """Size and tolerances; all values ours."""

    num_candidates: Annotated[int, Range(1, 100_000)] = 8192
    """Random poses stored in the file."""
    num_starts: Annotated[int, Range(1, 256)] = 8
    """Descents of every target: the candidates are dealt into so many groups, and the nearest of each group starts."""
    iterations: Annotated[int, Range(1, 1000)] = 25
    """Steps of every descent on the closed form, at most."""
    model_iterations: Annotated[int, Range(1, 1000)] = 8
    """Steps of every descent on the model, at most."""
    descent: DescentConfig = DescentConfig(position_tolerance=1e-4, orientation_tolerance=math.radians(0.05))
    """Weights, damping, tolerances: what single precision can hold."""

    def __post_init__(self):
        if self.num_candidates < self.num_starts:
            raise ValueError(
                f"num_candidates: got {self.num_candidates}, allowed: at least num_starts = {self.num_starts}"
            )


def compact_ik(robot: Robot, model: PoseFunction, config: CompactIKConfig, seed: int) -> SolveFunction:
    """The solver of one robot and model, its candidates drawn.

    Args:
        robot: in the precision in which it shall compute.
        model: lengths (num_cables,) [m] -> pose (9,), in the same precision.
        config: starts, steps, tolerances.
        seed: of the candidates.
    """
    coordinates, features = _candidates(robot, config, seed)
    limits = [jnp.asarray(count, jnp.int32) for count in (config.iterations, config.model_iterations)]

    def solve(target: jax.Array) -> Outputs:
        starts = _nearest_of_groups(coordinates, features, _features(config, target))
        wanted = jnp.broadcast_to(target[:, None], (9, config.num_starts))
        nominal = descend(robot, config.descent, starts, wanted, limits[0])
        ends = descend(robot, config.descent, nominal.coordinates, wanted, limits[1], tip_function(model))
        best = _preferred(robot, ends)
        return _answer(robot, model, config, target, ends.coordinates[..., best])

    return solve


def _candidates(robot: Robot, config: CompactIKConfig, seed: int) -> tuple[jax.Array, jax.Array]:
    """Coordinates (starts, candidates of a group, coordinates) of random poses, and their features (..., 9)."""
    count = config.num_candidates // config.num_starts * config.num_starts
    precision = jax.tree.leaves(robot)[0].dtype
    numbers = jax.random.uniform(jax.random.key(seed), (count, num_coordinates(robot)), precision)
    kind = kind_of(robot)
    configurations = jax.vmap(lambda row: kind.from_unit_cube(robot, row))(numbers)
    poses = jax.jit(jax.vmap(lambda one: forward_kinematics(robot, one)))(configurations)
    coordinates = jax.vmap(lambda one: kind.coordinates_of(robot, one))(configurations)
    groups = (config.num_starts, -1)
    return coordinates.reshape(*groups, coordinates.shape[1]), _features(config, poses).reshape(*groups, 9)


def _features(config: CompactIKConfig, poses: jax.Array) -> jax.Array:
    """Scaled such that squared distances are about the weighted squared errors [m]: poses or one pose (..., 9)."""
    return jnp.concatenate([poses[..., :3], config.descent.rotation_weight * poses[..., 3:]], axis=-1)


def _nearest_of_groups(coordinates: jax.Array, features: jax.Array, wanted: jax.Array) -> jax.Array:
    """The nearest candidate of every group as starts (coordinates, starts)."""
    nearest = jnp.argmin(jnp.sum((features - wanted) ** 2, axis=2), axis=1)
    return jnp.moveaxis(coordinates[jnp.arange(len(coordinates)), nearest], 0, -1)


def _preferred(robot: Robot, ends: Descent) -> jax.Array:
    """Which start to believe: of those at the target the one nearest to home, else the nearest.

    The nearest of several redundant answers would be chosen by rounding alone, and jump from target to target.
    """
    size = jnp.sum(ends.coordinates**2, axis=0)
    largest = 2.0 * jnp.max(size)
    return jnp.argmin(jnp.where(ends.is_near, size, largest + ends.residual.cost))


def _answer(
    robot: Robot, model: PoseFunction, config: CompactIKConfig, target: jax.Array, coordinates: jax.Array
) -> Outputs:
    lengths = lengths_of(robot, coordinates)
    pose = model(lengths)
    position, orientation = position_error(pose, target), orientation_error(pose, target)
    is_near = (position <= config.descent.position_tolerance) & (orientation <= config.descent.orientation_tolerance)
    return {
        "cable_lengths": lengths,
        "position_error": position,
        "orientation_error": orientation,
        "converged": is_near,
    }
