"""The engine in minimal coordinates: the arm's own equations of motion, float32, at a fraction of MuJoCo's cost.

What MuJoCo ties together with equality rows is one coordinate here, so that eight numbers move where MuJoCo moves forty.
Both come to rest at the same place; on the way they differ as two integrators do. Rows come first outside; inside the
batch comes last, as in `geometry.batch_last`.
"""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.robot.plant import Guarded, PhysicalParameters, PlantState, guarded, tilted
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.cables import strand_commands, strand_lengths
from qjrl.robot.quaternion_arm.coordinates import bends_from_half_angles
from qjrl.robot.quaternion_arm.dynamics import Load, joint_coordinates, tip_pose
from qjrl.robot.quaternion_arm.minimal_step import MinimalState, Physics, minimal_steps, strand_tension


@struct.dataclass
class MinimalArms:
    """The state of this engine, one row an arm."""

    physics: Physics
    state: Guarded
    """Of a `MinimalState`."""
    strand_commands: Any
    """(n, strands) rest lengths held [m]."""


@struct.dataclass
class MinimalEngine:
    """See `engine.Engine`; the robot's numbers are float32."""

    robot: QuaternionArm
    timestep: float = struct.field(pytree_node=False)

    def home(self, parameters: PhysicalParameters) -> MinimalArms:
        """Half angles, rates and impulses are zero there."""
        robot, count = self.robot, len(parameters.payload)
        zeros = jnp.zeros((count, robot.num_segments, 2), jnp.float32)
        rows = jnp.zeros((count, robot.num_strands + robot.num_segments), jnp.float32)
        held = strand_commands(robot, jnp.zeros(robot.num_cables, jnp.float32))
        return MinimalArms(
            _physics(robot, parameters),
            Guarded(MinimalState(zeros, zeros, rows), jnp.zeros(count, bool)),
            jnp.broadcast_to(held, (count, robot.num_strands)),
        )

    def placed(self, state: MinimalArms, joint_positions: jax.Array, strand_commands: jax.Array) -> MinimalArms:
        """At rest at joint positions (n, nq) [rad, m], of which each segment's first joint counts, holding rest lengths
        (n, strands) [m]."""
        first = np.concatenate([[0], np.cumsum(self.robot.joints_per_segment)[:-1]])
        joints = joint_positions.reshape(len(joint_positions), self.robot.num_joints, -1)
        moving = dataclasses.replace(state.state.moving, half_angles=joints[:, first, :2])
        return MinimalArms(state.physics, Guarded(moving, state.state.has_failed), strand_commands)

    def advance(self, state: MinimalArms, strand_commands: jax.Array, num_steps: int | jax.Array) -> MinimalArms:
        """Linearly implicit steps, see `minimal_step`."""
        before, commands = state.state.moving, strand_commands.astype(jnp.float32)
        physics, moving, held = _batch_last((state.physics, before, commands))
        timestep, count = jnp.float32(self.timestep), jnp.asarray(num_steps, jnp.int32)
        after = _batch_first(minimal_steps(self.robot, physics, moving, held, timestep, count))
        watched = (before.half_angles, before.rates, after.half_angles, after.rates)
        return MinimalArms(state.physics, guarded(state.state, after, watched), commands)

    def read(self, state: MinimalArms) -> PlantState:
        """As C MuJoCo would show it."""
        physics, moving, commands = _batch_last((state.physics, state.state.moving, state.strand_commands))
        coordinates = partial(joint_coordinates, self.robot)
        positions, velocities = jax.jvp(coordinates, (moving.half_angles,), (moving.rates,))
        lengths, rates = jax.jvp(self._strand_lengths, (moving.half_angles,), (moving.rates,))
        seen = PlantState(
            joint_positions=positions,
            joint_velocities=velocities,
            strand_lengths=lengths,
            strand_velocities=rates,
            strand_tension=strand_tension(self.robot, physics, lengths, commands),
            pose=tip_pose(self.robot, moving.half_angles),
            is_sound=~state.state.has_failed,
        )
        return _batch_first(seen)

    def _strand_lengths(self, half_angles: jax.Array) -> jax.Array:
        """(strands, arms) [m] inside the joints, of half angles (segments, 2, arms) [rad]."""

        def of_one(angles: jax.Array) -> jax.Array:
            return strand_lengths(self.robot, bends_from_half_angles(angles))

        return jax.vmap(of_one, in_axes=-1, out_axes=-1)(half_angles)


def _physics(robot: QuaternionArm, parameters: PhysicalParameters) -> Physics:
    """What differs between arms, one row each, float32."""
    load = Load(
        gravity=tilted(robot.gravity, parameters.tilt),
        armature_scale=parameters.armature_scale,
        payload=parameters.payload,
    )
    physics = Physics(
        load,
        strand_stiffness=robot.strand_stiffness * parameters.strand_gain,
        strand_damping=robot.strand_damping * parameters.strand_damping_scale,
        strand_friction=parameters.strand_friction,
    )
    return jax.tree.map(lambda values: jnp.asarray(values, jnp.float32), physics)


def _batch_last(tree: Any) -> Any:
    return jax.tree.map(lambda values: jnp.moveaxis(values, 0, -1), tree)


def _batch_first(tree: Any) -> Any:
    return jax.tree.map(lambda values: jnp.moveaxis(values, -1, 0), tree)
