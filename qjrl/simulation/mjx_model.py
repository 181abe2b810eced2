"""What all users of MJX share: its import without the lines it prints, the arm's model, a step, single precision, compiling."""

import contextlib
import dataclasses
import importlib.util
import io
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from flax import struct

from qjrl.config import ConfigError
from qjrl.simulation.settle_problem import Backend
from qjrl.xla_options import CPU_COMPILER_OPTIONS

with contextlib.redirect_stdout(io.StringIO()):  # two lines about warp where that is not installed
    from mujoco import mjx

__all__ = [
    "ArmState",
    "MjxArm",
    "Rows",
    "balanced",
    "balanced_step",
    "compile_batch",
    "load_arm",
    "look",
    "mjx",
    "single_precision",
    "tip_pose",
]

# In a batch MJX runs as many iterations as its slowest arm wants, and a tolerance that float32 cannot meet makes that all
# of them: few of both. Equality rows alone take one; with friction of 3 N one joint ends 0.35 mm from C after 3, 0.03 after 12.
SOLVER_ITERATIONS, FRICTION_ITERATIONS, SOLVER_TOLERANCE = 3, 12, 1e-6
LINE_SEARCH_ITERATIONS = 12
# Dry friction as hard as in C (0.9999) is beyond float32: at rest the solver now and then throws an arm at up to 2.5 rad/s.
# Measured on one joint with friction up to 3 N: with 0.999 at most 0.03 rad/s, and 0.1 mm of creep in 1.2 s; C: 5e-5 rad/s.
FRICTION_IMPEDANCE = 0.999

# An array of numpy's on the host, of JAX's inside compiled code.
Rows = Any


@dataclasses.dataclass(frozen=True)
class MjxArm:
    """One arm's model on both sides."""

    host: mujoco.MjModel
    """C MuJoCo's, from which MJX's was made."""
    model: mjx.Model
    """MJX's, float32, on JAX's default device."""
    data: mjx.Data
    """One simulation at home: a template to replace states in."""

    @property
    def tip(self) -> int:
        """Index of the site whose pose is the arm's."""
        return mujoco.mj_name2id(self.host, mujoco.mjtObj.mjOBJ_SITE, "tip")


@struct.dataclass
class ArmState:
    """What the next step depends on, one row a simulation; float32."""

    joint_positions: Rows
    joint_velocities: Rows
    strand_commands: Rows
    warm_start: Rows
    """Accelerations from which the constraint solver starts."""

    def placed_in(self, home: mjx.Data) -> mjx.Data:
        """The template of one simulation with this state, a single row, in it."""
        return home.replace(
            qpos=self.joint_positions,
            qvel=self.joint_velocities,
            ctrl=self.strand_commands,
            qacc_warmstart=self.warm_start,
        )

    def moved_to(self, data: mjx.Data) -> "ArmState":
        """Where one simulation has come, holding the same commands."""
        return ArmState(data.qpos, data.qvel, self.strand_commands, data.qacc_warmstart)


def load_arm(mjcf: str, strand_friction: float | None = None, backend: Backend = "mjx") -> MjxArm:
    """An arm's model for MJX.

    Args:
        mjcf: of the arm, from `build_mjcf`.
        strand_friction: of all actuated tendons, instead of the MJCF's [N]. MJX makes friction rows only where this is
            above 0 here.
        backend: "mjx" or "mjx-warp".

    Raises:
        ConfigError: Warp is not installed.
    """
    implementation = "warp" if backend == "mjx-warp" else "jax"
    if implementation == "warp" and importlib.util.find_spec("warp") is None:
        raise ConfigError("simulation.backend: got mjx-warp, allowed: mujoco, mjx, until pip install 'qjrl[warp]'")
    host = mujoco.MjModel.from_xml_string(mjcf)
    host.opt.tolerance = SOLVER_TOLERANCE
    if implementation == "jax":  # Warp stops arm by arm
        host.opt.iterations = SOLVER_ITERATIONS if strand_friction is None else FRICTION_ITERATIONS
        host.opt.ls_iterations = LINE_SEARCH_ITERATIONS
    host.dof_solimp[:, :2] = host.tendon_solimp_fri[:, :2] = FRICTION_IMPEDANCE
    if strand_friction is not None:
        host.tendon_frictionloss[: host.nu] = strand_friction
    with single_precision():
        return MjxArm(host, mjx.put_model(host, impl=implementation), mjx.make_data(host, impl=implementation))


def single_precision() -> contextlib.AbstractContextManager:
    """Around every call into MJX: what is made and compiled inside is float32 and int32, whatever the process uses.

    With x64 on, MJX would compute in float64, and its integers would change their type within a loop.
    """
    return jax.enable_x64(False)


def compile_batch(function: Callable[..., Any], in_axes: tuple[int | None, ...], *arguments: Any) -> Callable[..., Any]:
    """`function` of one simulation, over a batch, compiled now for arguments like these on JAX's default device."""
    options = CPU_COMPILER_OPTIONS if jax.default_backend() == "cpu" else None
    with single_precision():
        return jax.jit(jax.vmap(function, in_axes)).lower(*arguments).compile(options)


def balanced_step(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """`mjx.step` of an implicitfast model, in JAX without the kicks that float32 gives it at rest, see `balanced`."""
    if model.impl == mjx.Impl.WARP:
        return mjx.step(model, data)
    return mjx.implicit(model, balanced(model, mjx.forward(model, data)))


def balanced(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """The solved data with the constraint force that its accelerations imply: M qacc - qfrc_smooth.

    MJX's line search takes no step whose gain is lost in the rounding of the cost, and leaves some newton metres between forces
    and accelerations. The accelerations are good, but `implicit` computes its own from the forces: hard rows then throw a
    resting arm at a mean of 0.04 rad/s every few dozen steps, 2.6e-3 rad/s on average. So 4e-5 rad/s are left.
    """
    return data.replace(qfrc_constraint=mjx.mul_m(model, data, data.qacc) - data.qfrc_smooth)


def look(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """One simulation with what its sensors show where it is: lengths, velocities, forces, the tip."""
    if model.impl == mjx.Impl.WARP:  # has no parts of a step
        return mjx.forward(model, data)
    return mjx.fwd_actuation(model, mjx.fwd_velocity(model, mjx.fwd_position(model, data)))


def tip_pose(data: mjx.Data, tip: int) -> jax.Array:
    """Pose (9,) of one simulation's site `tip`."""
    rotation = data.site_xmat[tip].reshape(3, 3)
    return jnp.concatenate([data.site_xpos[tip], rotation[:, 0], rotation[:, 1]])
