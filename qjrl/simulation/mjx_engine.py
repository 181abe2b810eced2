"""The engine in MJX, float32, for accelerators: in JAX's operations or in the kernels of NVIDIA's Warp."""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.robot import build_mjcf, strand_commands
from qjrl.robot.plant import Guarded, PhysicalParameters, PlantState, guarded, tilted
from qjrl.robot.solver_options import SolverOptions
from qjrl.robot.verbs import Robot
from qjrl.simulation.mjx_model import (
    ArmState,
    Rows,
    balanced_step,
    load_arm,
    look,
    mjx,
    tip_pose,
)
from qjrl.simulation.payload import tip_body
from qjrl.simulation.settle_problem import Backend

# MJX holds a strand whose friction row has the bound 0 still instead of leaving it free; this much moves nothing [N].
LEAST_FRICTION = 1e-4


@struct.dataclass
class _Physics:
    """What differs between the simulations' models, one row a simulation."""

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
    joint_inverse_inertia: Rows = None
    """`dof_invweight0`: follows the armature, and with it how hard the equality rows are."""
    tendon_inverse_inertia: Rows = None
    """`tendon_invweight0`: likewise for the height, stop and friction rows."""


@struct.dataclass
class MjxArms:
    """The state of this engine, one row an arm."""

    physics: _Physics
    state: Guarded
    """Of an `ArmState`."""


@struct.dataclass
class MjxEngine:
    """See `engine.Engine`; made by `mjx_engine`."""

    robot: Robot
    model: mjx.Model
    data: mjx.Data
    """A simulation at home: a template to replace states in."""
    plain: mjx.Model
    """The model in JAX's operations, from which constants are derived."""
    timestep: float = struct.field(pytree_node=False)
    tip: int = struct.field(pytree_node=False)
    arm: Any = struct.field(pytree_node=False)
    """C MuJoCo's model, of which the last body is read."""

    def home(self, parameters: PhysicalParameters) -> MjxArms:
        """Joints at zero, with what MuJoCo derives from armature and payload."""
        physics = self._physics(parameters)
        count, model = len(parameters.payload), self.arm.model
        zeros = lambda width: jnp.zeros((count, width), jnp.float32)  # noqa: E731
        held = strand_commands(self.robot, jnp.zeros(self.robot.num_cables, jnp.float32))
        held = jnp.broadcast_to(held, (count, model.nu))
        return MjxArms(
            physics,
            Guarded(ArmState(zeros(model.nq), zeros(model.nv), held, zeros(model.nv)), jnp.zeros(count, bool)),
        )

    def placed(self, state: MjxArms, joint_positions: jax.Array, strand_commands: jax.Array) -> MjxArms:
        """At rest at joint positions (n, nq) [rad, m], holding rest lengths (n, strands) [m]."""
        moving = dataclasses.replace(
            state.state.moving, joint_positions=joint_positions, strand_commands=strand_commands
        )
        return MjxArms(state.physics, Guarded(moving, state.state.has_failed))

    def advance(self, state: MjxArms, strand_commands: jax.Array, num_steps: int | jax.Array) -> MjxArms:
        """`mjx_model.balanced_step`s."""

        def one(physics: _Physics, arm: ArmState) -> ArmState:
            model = _individual(self.model, physics)
            placed = arm.placed_in(self.data)
            return arm.moved_to(jax.lax.fori_loop(0, num_steps, lambda _, data: balanced_step(model, data), placed))

        before = dataclasses.replace(state.state.moving, strand_commands=strand_commands.astype(jnp.float32))
        after = jax.vmap(one)(state.physics, before)
        watched = [(arm.joint_positions, arm.joint_velocities) for arm in (before, after)]
        return MjxArms(state.physics, guarded(state.state, after, watched))

    def read(self, state: MjxArms) -> PlantState:
        """As C MuJoCo would show it."""
        strands = slice(0, self.robot.num_strands)

        def one(physics: _Physics, arm: ArmState) -> dict[str, jax.Array]:
            data = look(_individual(self.model, physics), arm.placed_in(self.data))
            return {
                "strand_lengths": data.ten_length[strands],
                "strand_velocities": data._impl.ten_velocity[strands],
                "strand_tension": 0.0 - data.actuator_force,
                "pose": tip_pose(data, self.tip),
            }

        moving = state.state.moving
        seen = jax.vmap(one)(state.physics, moving)
        is_sound = ~state.state.has_failed & jnp.all(jnp.isfinite(seen["pose"]), axis=1)
        return PlantState(
            joint_positions=moving.joint_positions, joint_velocities=moving.joint_velocities, is_sound=is_sound, **seen
        )

    def _physics(self, parameters: PhysicalParameters) -> _Physics:
        host = self.arm.model
        tip = tip_body(self.robot, host, parameters.payload)
        physics = _Physics(
            strand_damping_scale=parameters.strand_damping_scale,
            strand_friction=jnp.maximum(parameters.strand_friction, LEAST_FRICTION),
            armature_scale=parameters.armature_scale,
            strand_gain=parameters.strand_gain,
            gravity=tilted(jnp.asarray(host.opt.gravity), parameters.tilt),
            tip_mass=tip.mass,
            tip_centre=tip.centre,
            tip_inertia=tip.inertia,
        )
        physics = jax.tree.map(lambda values: jnp.asarray(values, jnp.float32), physics)
        # With x64 on, MJX derives float64 from float32; Warp's kernels take nothing but float32.
        inertias = [rows.astype(jnp.float32) for rows in jax.vmap(partial(_inertias, self.plain))(physics)]
        return dataclasses.replace(physics, joint_inverse_inertia=inertias[0], tendon_inverse_inertia=inertias[1])


class HostModel:
    """C MuJoCo's model as a static part of a pytree: equal to itself alone."""

    def __init__(self, model: Any):
        self.model = model


def mjx_engine(robot: Robot, timestep: float, backend: Backend) -> MjxEngine:
    """An engine of a robot whose numbers are float32.

    Raises:
        ConfigError: Warp is asked for and not installed.
    """
    mjcf = build_mjcf(robot, SolverOptions(timestep=timestep))
    arm = load_arm(mjcf, 1.0, backend)
    plain = arm if backend == "mjx" else load_arm(mjcf, 1.0, "mjx")
    return MjxEngine(robot, arm.model, arm.data, plain.model, timestep, arm.tip, HostModel(arm.host))


def _inertias(model: mjx.Model, physics: _Physics) -> tuple[jax.Array, jax.Array]:
    """What MuJoCo's `mj_setConst` derives at home: inverse inertias of joints and tendons. (The mean inertia, the scale of the
    solver's tolerance, stays the model's.)"""
    model = _with_inertia(model, physics)
    data = mjx.make_data(model)
    data = mjx.tendon(model, mjx.crb(model, mjx.com_pos(model, mjx.kinematics(model, data))))
    mass = mjx.full_m(model, data)
    inverse = jnp.linalg.inv(mass)
    slopes = data._impl.ten_J
    return jnp.diag(inverse), jnp.sum((slopes @ inverse) * slopes, axis=1)


def _with_inertia(model: mjx.Model, physics: _Physics) -> mjx.Model:
    return model.tree_replace(
        {
            "dof_armature": model.dof_armature * physics.armature_scale,
            "body_mass": model.body_mass.at[-1].set(physics.tip_mass),
            "body_ipos": model.body_ipos.at[-1].set(physics.tip_centre),
            "body_inertia": model.body_inertia.at[-1].set(physics.tip_inertia),
        }
    )


def _individual(model: mjx.Model, physics: _Physics) -> mjx.Model:
    """The model with one simulation's physical parameters; strands are the first tendons, the payload's body is the last."""
    strands = slice(0, model.nu)
    return _with_inertia(model, physics).tree_replace(
        {
            "tendon_damping": model.tendon_damping.at[strands].multiply(physics.strand_damping_scale),
            "tendon_frictionloss": model.tendon_frictionloss.at[strands].set(physics.strand_friction),
            "actuator_gainprm": model.actuator_gainprm * physics.strand_gain[:, None],
            "actuator_biasprm": model.actuator_biasprm * physics.strand_gain[:, None],
            "opt.gravity": physics.gravity,
            "dof_invweight0": physics.joint_inverse_inertia,
            "tendon_invweight0": physics.tendon_inverse_inertia,
        }
    )
