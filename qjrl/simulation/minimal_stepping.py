"""Step many arms in time in minimal coordinates, in JAX and float32: the contract of `MujocoStepper`, at a fraction of its cost.

What MuJoCo ties together with equality rows is one coordinate here, so that eight numbers move where MuJoCo moves forty.
Both come to rest at the same place; on the way they differ as two integrators do.
"""

import dataclasses
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.cores import usable_cores
from qjrl.robot.quaternion_arm.dynamics import Load, equations_of_motion, joint_coordinates, tip_pose
from qjrl.robot.verbs import Robot
from qjrl.simulation.minimal_step import MinimalState, Physics, minimal_steps, strand_tension
from qjrl.simulation.stepping import PhysicalParameters, Readout, tilted
from qjrl.simulation.xla_options import CPU_COMPILER_OPTIONS

# Beyond it a simulation counts as diverged [rad, rad/s].
LARGEST_VALUE = 1e4
# Of the integrator [s].
TIMESTEP = 0.005


@struct.dataclass
class _Seen:
    """What the arms show; lanes last, float32."""

    joint_positions: jax.Array
    joint_velocities: jax.Array
    strand_lengths: jax.Array
    strand_velocities: jax.Array
    strand_tension: jax.Array
    pose: jax.Array


class MinimalStepper:
    """`num_sims` simulations of one robot, in as many blocks side by side as there are threads."""

    def __init__(self, robot: Robot, num_sims: int, timestep: float = TIMESTEP, num_threads: int = 0):
        self.num_sims, self.timestep, self._robot = num_sims, timestep, robot
        threads = min(num_threads or usable_cores(), num_sims) if jax.default_backend() == "cpu" else 1
        self._blocks = [part for part in np.array_split(np.arange(num_sims), threads) if len(part)]
        self._pool = ThreadPoolExecutor(len(self._blocks))
        rows = robot.num_strands + robot.num_segments
        zeros = lambda *shape: np.zeros((*shape, num_sims), np.float32)  # noqa: E731
        self._state = MinimalState(zeros(robot.num_segments, 2), zeros(robot.num_segments, 2), zeros(rows))
        self._commands = zeros(robot.num_strands)
        self._parameters = PhysicalParameters.nominal(robot, num_sims)
        self._physics = _physics_of(robot, self._parameters)
        self._has_failed = np.zeros(num_sims, bool)
        self._seen: _Seen | None = None

    def reset(
        self, ids: np.ndarray, joint_positions: np.ndarray, strand_commands: np.ndarray, parameters: PhysicalParameters
    ) -> None:
        """Put simulations `ids` at rest at joint positions (len(ids), nq), holding commands, with new parameters."""
        self._parameters.assign(ids, parameters.arrays())
        self._physics = _physics_of(self._robot, self._parameters)
        first = _first_joints(self._robot, np.broadcast_to(joint_positions, (len(ids), np.shape(joint_positions)[-1])))
        self._state.half_angles[..., ids] = first
        self._state.rates[..., ids], self._state.impulses[..., ids] = 0.0, 0.0
        self._commands[:, ids] = np.transpose(np.broadcast_to(strand_commands, (len(ids), len(self._commands))))
        self._has_failed[ids] = False
        self._seen = None

    def step(self, strand_commands: np.ndarray, num_steps: int) -> None:
        """Hold rest lengths (n, strands) [m] for `num_steps` time steps; a simulation that diverges stays where it was."""
        before = self._state
        self._commands = np.array(np.transpose(strand_commands), np.float32)
        advance = partial(_advance, self._robot, timestep=np.float32(self.timestep), num_steps=np.int32(num_steps))
        after = self._in_blocks(advance, before, self._commands)
        values = np.concatenate([value.reshape(-1, self.num_sims) for value in (after.half_angles, after.rates)])
        is_sound = np.all(np.abs(values) < LARGEST_VALUE, axis=0) & ~self._has_failed  # False for NaN
        self._has_failed = ~is_sound
        self._state = jax.tree.map(lambda new, old: np.where(is_sound, new, old), after, before)
        self._seen = None

    def read(self) -> Readout:
        """The state of all simulations now."""
        if self._seen is None:
            self._seen = self._in_blocks(partial(_look, self._robot), self._state, self._commands)
        seen = jax.tree.map(lambda value: np.ascontiguousarray(value.T, np.float64), self._seen)
        fields = {field.name: getattr(seen, field.name) for field in dataclasses.fields(seen)}
        return Readout(**fields, is_finite=~self._has_failed)

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that a bitwise continuation needs, a row for each simulation."""
        moving = vars(self._state) | {"commands": self._commands}
        return {
            **{name: np.moveaxis(values, -1, 0).copy() for name, values in moving.items()},
            "has_failed": self._has_failed.copy(),
            **self._parameters.arrays(),
        }

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go back to what `get_state` returned."""
        self._parameters.assign(np.arange(self.num_sims), state)
        self._physics = _physics_of(self._robot, self._parameters)
        moving = {name: np.moveaxis(state[name], 0, -1).copy() for name in (*vars(self._state), "commands")}
        self._commands, self._has_failed = moving.pop("commands"), np.array(state["has_failed"])
        self._state = MinimalState(**moving)
        self._seen = None

    def _in_blocks(self, function, state: MinimalState, commands: np.ndarray):
        """A function of (physics, state, commands) on every block of lanes at once; numpy in and out."""

        def run(block: np.ndarray):
            lanes = slice(block[0], block[-1] + 1)
            cut = jax.tree.map(lambda value: value[..., lanes], (self._physics, state, commands))
            return jax.tree.map(np.asarray, function(*cut))

        return jax.tree.map(lambda *parts: np.concatenate(parts, axis=-1), *self._pool.map(run, self._blocks))


def _physics_of(robot: Robot, parameters: PhysicalParameters) -> Physics:
    """Parameters of all simulations as the step takes them: lanes last, float32."""
    single = lambda values: np.asarray(values, np.float32)  # noqa: E731
    strands, mechanics = robot.config.strands, robot.config.mechanics
    load = Load(
        gravity=single(tilted(np.array(mechanics.gravity), parameters.tilt).T),
        armature_scale=single(parameters.armature_scale),
        payload=single(parameters.payload),
    )
    return Physics(
        load,
        strand_stiffness=single(float(robot.strand_stiffness) * parameters.strand_gain.T),
        strand_damping=single(strands.damping * parameters.strand_damping_scale),
        strand_friction=single(parameters.strand_friction),
    )


def _see(robot: Robot, physics: Physics, state: MinimalState, commands: jax.Array) -> _Seen:
    equations = equations_of_motion(robot, physics.load, state.half_angles, state.rates)
    coordinates = partial(joint_coordinates, robot)
    positions, velocities = jax.jvp(coordinates, (state.half_angles,), (state.rates,))
    flat = state.rates.reshape(2 * robot.num_segments, 1, -1)
    return _Seen(
        positions,
        velocities,
        equations.strands,
        jnp.sum(flat * equations.strand_slope, axis=0),
        strand_tension(robot, physics, equations.strands, commands),
        tip_pose(robot, state.half_angles),
    )


def _first_joints(robot: Robot, joint_positions: np.ndarray) -> np.ndarray:
    """Half angles (segments, 2, n) of joint positions (n, nq): those of each segment's first joint."""
    first = np.concatenate([[0], np.cumsum(robot.joints_per_segment)[:-1]])
    return joint_positions.reshape(len(joint_positions), robot.num_joints, -1)[:, first, :2].transpose(1, 2, 0)


_OPTIONS = CPU_COMPILER_OPTIONS if jax.default_backend() == "cpu" else {}
_advance = jax.jit(minimal_steps, compiler_options=_OPTIONS)
_look = jax.jit(_see, compiler_options=_OPTIONS)
