"""A simulated robot as every engine shows it: its state, what may differ from robot to robot, and when it has diverged.

One row a robot, in whatever engine: C MuJoCo, MJX, or equations that a kind of robot brings itself.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.robot.kind import Robot

# Radius of the ball that is a payload, whose centre is the MJCF's site `tip` [m].
PAYLOAD_RADIUS = 0.01
# Beyond it a simulation counts as diverged, in every engine [rad, rad/s].
LARGEST_VALUE = 1e4


@struct.dataclass
class PlantState:
    """The physics of all simulations after a step, one row a simulation; of C MuJoCo live views, copy what must last."""

    joint_positions: Any
    """(n, nq) [rad, m]."""
    joint_velocities: Any
    """(n, nv) [rad/s, m/s]."""
    strand_lengths: Any
    """(n, strands) [m]."""
    strand_velocities: Any
    """(n, strands) [m/s]."""
    strand_tension: Any
    """(n, strands) [N]."""
    pose: Any
    """(n, 9) [m, -]."""
    is_sound: Any
    """(n,) False where the simulation diverged since its last reset."""


@struct.dataclass
class PhysicalParameters:
    """What may differ between simulations, one value a simulation; ones, zeros and the robot's gravity are nominal."""

    strand_damping_scale: Any
    """(n,) times the robot's."""
    strand_friction: Any
    """(n,) dry friction along every strand [N]."""
    armature_scale: Any
    """(n,) times the robot's."""
    gain_scale: Any
    """(n,) times the strand servo's stiffness."""
    tilt: Any
    """(n, 2) rotation of gravity about the base's x and y [rad]."""
    strand_stiffness_scale: Any
    """(n, strands) times the stiffness of each strand, on top of `gain_scale`."""
    payload: Any
    """(n,) mass at the tip [kg], in place of the robot's."""

    @classmethod
    def nominal(cls, robot: Robot, count: int) -> "PhysicalParameters":
        """The robot as described, `count` times."""
        return cls(
            strand_damping_scale=np.ones(count),
            strand_friction=np.full(count, robot.strand_friction),
            armature_scale=np.ones(count),
            gain_scale=np.ones(count),
            tilt=np.zeros((count, 2)),
            strand_stiffness_scale=np.ones((count, robot.num_strands)),
            payload=np.full(count, robot.payload),
        )

    @property
    def strand_gain(self) -> Any:
        """(n, strands) times the stiffness as described, of both scales together."""
        return self.gain_scale[:, None] * self.strand_stiffness_scale

    def arrays(self) -> dict[str, np.ndarray]:
        """Field name -> copy of its values."""
        return {field.name: getattr(self, field.name).copy() for field in dataclasses.fields(self)}

    def assign(self, ids: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
        """Write rows `ids` of every field from `arrays`, of which other names are left alone."""
        for field in dataclasses.fields(self):
            getattr(self, field.name)[ids] = arrays[field.name]


@struct.dataclass
class Guarded:
    """The moving part of an engine's state, and which arms have left the finite and the plausible."""

    moving: Any
    has_failed: Any
    """(n,) since the arm was put at home."""


def guarded(before: Guarded, after: Any, watched: Any) -> Guarded:
    """`after` where it is sound; an arm whose `watched` values (n, ...), before or after, are not stays where it was."""
    leaves = [jnp.abs(leaf.reshape(len(leaf), -1)) for leaf in jax.tree.leaves(watched)]
    is_sound = jnp.all(jnp.concatenate(leaves, axis=1) < LARGEST_VALUE, axis=1)  # False for NaN
    has_failed = before.has_failed | ~is_sound

    def kept(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(has_failed.reshape(-1, *[1] * (new.ndim - 1)), old, new)

    return Guarded(jax.tree.map(kept, after, before.moving), has_failed)


def tilted(gravity: Any, tilt: Any) -> jax.Array:
    """Gravity (3,) rotated about x, then y, by angles (n, 2) [rad]: (n, 3)."""
    (cx, cy), (sx, sy) = jnp.cos(tilt).T, jnp.sin(tilt).T
    x, y, z = gravity
    y_turned, z_turned = cx * y - sx * z, sx * y + cx * z
    return jnp.stack([cy * x + sy * z_turned, y_turned, -sy * x + cy * z_turned], axis=1)
