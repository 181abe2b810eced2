"""Step many arms in time with MJX, in float32, for accelerators: the same contract as `MujocoStepper`."""

import copy
import dataclasses
from collections.abc import Callable, Mapping
from functools import partial

import jax
import mujoco
import numpy as np
from flax import struct

from qjrl.progress import compiling
from qjrl.robot import build_mjcf
from qjrl.robot.quaternion_arm.mjcf import SolverOptions
from qjrl.robot.verbs import Robot
from qjrl.simulation.mjx_model import (
    ArmState,
    Rows,
    balanced_step,
    compile_batch,
    load_arm,
    look,
    mjx,
    single_precision,
    tip_pose,
)
from qjrl.simulation.payload import tip_body
from qjrl.simulation.settle_problem import Backend
from qjrl.simulation.stepping import PhysicalParameters, Readout, tilted

# MJX holds a strand whose friction row has the bound 0 still instead of leaving it free; this much moves nothing [N].
LEAST_FRICTION = 1e-4
# As MuJoCo's mjMAXVAL: beyond it a simulation counts as diverged [rad/s, rad].
LARGEST_VALUE = 1e10


@struct.dataclass
class _Physics:
    """What differs between the simulations' models, one row a simulation; float32."""

    strand_damping_scale: Rows
    strand_friction: Rows
    armature_scale: Rows
    strand_gain: Rows
    """Times the strand servos' stiffness, one a strand."""
    gravity: Rows
    tip_mass: Rows
    tip_centre: Rows
    tip_inertia: Rows
    """Of the last body, which carries the payload (`payload.TipBody`)."""
    joint_inverse_inertia: Rows
    """`dof_invweight0`: follows the armature, and with it how hard the equality rows are."""
    tendon_inverse_inertia: Rows
    """`tendon_invweight0`: likewise for the height, stop and friction rows."""
    mean_inertia: Rows
    """Scale of the solver's tolerance."""


@struct.dataclass
class _Measured:
    """What the simulations show at a state, one row a simulation; float32."""

    tendon_lengths: Rows
    tendon_velocities: Rows
    actuator_force: Rows
    pose: Rows


class MjxStepper:
    """`num_sims` simulations of one robot on JAX's default device; states lie on the host between calls."""

    def __init__(self, robot: Robot, num_sims: int, timestep: float = 0.004, backend: Backend = "mjx"):
        self.num_sims, self.timestep, self.num_strands, self._robot = num_sims, timestep, robot.num_strands, robot
        self._arm = load_arm(build_mjcf(robot, SolverOptions(timestep=timestep)), 1.0, backend)
        host = self._arm.host
        zeros = lambda width: np.zeros((num_sims, width), np.float32)  # noqa: E731
        self._state = ArmState(zeros(host.nq), zeros(host.nv), zeros(host.nu), zeros(host.nv))
        self._measured: _Measured | None = None
        self._has_failed = np.zeros(num_sims, bool)
        self._parameters = PhysicalParameters.nominal(robot, num_sims)
        self._physics = _Physics(
            *(np.ones(num_sims, np.float32) for _ in range(3)),
            strand_gain=zeros(host.nu),
            gravity=zeros(3),
            tip_mass=np.ones(num_sims, np.float32),
            tip_centre=zeros(3),
            tip_inertia=zeros(3),
            joint_inverse_inertia=zeros(host.nv),
            tendon_inverse_inertia=zeros(host.ntendon),
            mean_inertia=np.ones(num_sims, np.float32),
        )
        self._set_parameters(np.arange(num_sims))
        self._advance = self._compile()

    def reset(
        self, ids: np.ndarray, joint_positions: np.ndarray, strand_commands: np.ndarray, parameters: PhysicalParameters
    ) -> None:
        """Put simulations `ids` at rest at joint positions (len(ids), nq), holding commands, with new parameters."""
        self._parameters.assign(ids, parameters.arrays())
        self._set_parameters(ids)
        state = self._state
        state.joint_positions[ids], state.joint_velocities[ids] = joint_positions, 0.0
        state.strand_commands[ids], state.warm_start[ids] = strand_commands, 0.0
        self._has_failed[ids] = False
        self._measured = None

    def step(self, strand_commands: np.ndarray, num_steps: int) -> None:
        """Hold rest lengths (n, strands) [m] for `num_steps` time steps; a simulation that diverges stays where it was."""
        before = dataclasses.replace(self._state, strand_commands=np.array(strand_commands, np.float32))
        after, measured = self._run(before, num_steps)
        is_sound = _is_sound(after) & ~self._has_failed
        self._has_failed = ~is_sound
        self._state = jax.tree.map(lambda new, old: np.where(is_sound[:, None], new, old), after, before)
        self._measured = measured if is_sound.all() else None

    def read(self) -> Readout:
        """The state of all simulations now, float64 as from C MuJoCo."""
        if self._measured is None:
            self._measured = self._run(self._state, 0)[1]
        state, measured = jax.tree.map(lambda value: np.asarray(value, np.float64), (self._state, self._measured))
        strands = slice(0, self.num_strands)
        return Readout(
            joint_positions=state.joint_positions,
            joint_velocities=state.joint_velocities,
            strand_lengths=measured.tendon_lengths[:, strands],
            strand_velocities=measured.tendon_velocities[:, strands],
            strand_tension=0.0 - measured.actuator_force,
            pose=measured.pose,
            is_finite=~self._has_failed & np.isfinite(measured.pose).all(axis=1),
        )

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that a bitwise continuation needs."""
        state = {name: array.copy() for name, array in vars(self._state).items()}
        return {"has_failed": self._has_failed.copy(), **state, **self._parameters.arrays()}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go back to what `get_state` returned."""
        everyone = np.arange(self.num_sims)
        self._parameters.assign(everyone, state)
        self._set_parameters(everyone)
        self._state = ArmState(**{name: np.array(state[name]) for name in vars(self._state)})
        self._has_failed, self._measured = np.array(state["has_failed"]), None

    def _run(self, state: ArmState, num_steps: int) -> tuple[ArmState, _Measured]:
        with single_precision():
            return self._advance(self._arm.model, self._arm.data, self._physics, state, np.int32(num_steps))

    def _set_parameters(self, ids: np.ndarray) -> None:
        ours, physics = self._parameters, self._physics
        physics.strand_damping_scale[ids] = ours.strand_damping_scale[ids]
        physics.strand_friction[ids] = np.maximum(ours.strand_friction[ids], LEAST_FRICTION)
        physics.armature_scale[ids] = ours.armature_scale[ids]
        physics.strand_gain[ids] = ours.strand_gain[ids]
        physics.gravity[ids] = tilted(self._arm.host.opt.gravity, ours.tilt[ids])
        tip = tip_body(self._robot, self._arm.host, ours.payload[ids])
        physics.tip_mass[ids], physics.tip_centre[ids], physics.tip_inertia[ids] = tip.mass, tip.centre, tip.inertia
        self._derive_constants(ids)

    def _derive_constants(self, ids: np.ndarray) -> None:
        """What C MuJoCo derives from armature and payload, by C MuJoCo: they scale how hard the rows are."""
        host, physics = copy.copy(self._arm.host), self._physics
        data = mujoco.MjData(host)
        for index in ids:
            host.dof_armature[:] = self._arm.host.dof_armature * self._parameters.armature_scale[index]
            host.body_mass[-1], host.body_ipos[-1] = physics.tip_mass[index], physics.tip_centre[index]
            host.body_inertia[-1] = physics.tip_inertia[index]
            mujoco.mj_setConst(host, data)
            physics.joint_inverse_inertia[index] = host.dof_invweight0
            physics.tendon_inverse_inertia[index] = host.tendon_invweight0
            physics.mean_inertia[index] = host.stat.meaninertia

    def _compile(self) -> Callable[..., tuple[ArmState, _Measured]]:
        """Compile now, so that the first step is as fast as the others."""
        example = (self._arm.model, self._arm.data, self._physics, self._state, np.int32(0))
        with compiling(f"MJX for {self.num_sims} arms"):
            return compile_batch(partial(_advance, self._arm.tip), (None, None, 0, 0, None), *example)


def _advance(
    tip: int, model: mjx.Model, home: mjx.Data, physics: _Physics, state: ArmState, num_steps: jax.Array
) -> tuple[ArmState, _Measured]:
    """One simulation `num_steps` time steps on, and what it shows there (site `tip`'s pose)."""
    model = _individual(model, physics)
    data = jax.lax.fori_loop(0, num_steps, lambda _, data: balanced_step(model, data), state.placed_in(home))
    data = look(model, data)
    seen = _Measured(data.ten_length, data._impl.ten_velocity, data.actuator_force, tip_pose(data, tip))
    return state.moved_to(data), seen


def _individual(model: mjx.Model, physics: _Physics) -> mjx.Model:
    """The model with one simulation's physical parameters; strands are the first tendons, the payload's body is the last."""
    strands = slice(0, model.nu)
    return model.tree_replace(
        {
            "tendon_damping": model.tendon_damping.at[strands].multiply(physics.strand_damping_scale),
            "tendon_frictionloss": model.tendon_frictionloss.at[strands].set(physics.strand_friction),
            "dof_armature": model.dof_armature * physics.armature_scale,
            "actuator_gainprm": model.actuator_gainprm * physics.strand_gain[:, None],
            "actuator_biasprm": model.actuator_biasprm * physics.strand_gain[:, None],
            "opt.gravity": physics.gravity,
            "body_mass": model.body_mass.at[-1].set(physics.tip_mass),
            "body_ipos": model.body_ipos.at[-1].set(physics.tip_centre),
            "body_inertia": model.body_inertia.at[-1].set(physics.tip_inertia),
            "dof_invweight0": physics.joint_inverse_inertia,
            "tendon_invweight0": physics.tendon_inverse_inertia,
            "stat.meaninertia": physics.mean_inertia,
        }
    )


def _is_sound(state: ArmState) -> np.ndarray:
    """(n,) whether positions and velocities are finite and not absurd."""
    values = np.concatenate([state.joint_positions, state.joint_velocities, state.warm_start], axis=1)
    return np.all(np.abs(values) < LARGEST_VALUE, axis=1)  # False for NaN
