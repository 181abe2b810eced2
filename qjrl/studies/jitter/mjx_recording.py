"""Joint velocities at every time step of commands played in MJX, in float32, as it is and with balanced forces."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from qjrl.progress import compiling
from qjrl.robot import joint_positions
from qjrl.robot.verbs import home
from qjrl.simulation.mjx_model import ArmState, MjxArm, Rows, balanced, compile_batch, load_arm, mjx, single_precision
from qjrl.studies.jitter.cable_models import CableModel, Play, Recording


@struct.dataclass
class _Simulation:
    """What differs between the simulations, one row each; float32."""

    half_width: Rows
    solref: Rows
    solimp: Rows
    tolerance: Rows
    is_balanced: Rows


def record_mjx(play: Play, is_balanced: np.ndarray) -> Recording:
    """Play all simulations of `play` side by side; compiling takes a minute.

    Args:
        is_balanced: (n,) whether the integrator gets balanced forces, see `mjx_model.balanced`, or what MJX's solver left.
    """
    arm = load_arm(play.mjcf)
    targets = play.strand_targets.astype(np.float32)
    single, limits = partial(np.asarray, dtype=np.float32), play.limits
    rows = (single(limits.half_width), single(limits.solref), single(limits.solimp))
    batch = _Simulation(*rows, tolerance=single(play.tolerance), is_balanced=np.asarray(is_balanced))
    state, recorded = _at_home(play, arm), []
    with single_precision():
        advance = _compile(play, arm, batch, state, targets[0])
        for target in targets:
            state, velocities = advance(batch, state, target)
            recorded.append(np.asarray(velocities))
    return Recording(np.concatenate(recorded, axis=1), _tips(arm, np.asarray(state.joint_positions)))


def _at_home(play: Play, arm: MjxArm) -> ArmState:
    start = np.asarray(joint_positions(play.robot, home(play.robot)), np.float32)
    still = np.zeros((play.num_sims, arm.host.nv), np.float32)
    commands = np.zeros((play.num_sims, arm.host.nu), np.float32)
    return ArmState(np.tile(start, (play.num_sims, 1)), still, commands, still)


def _compile(play: Play, arm: MjxArm, batch: _Simulation, state: ArmState, target: np.ndarray) -> Callable:
    """Of batch, state and targets, over all simulations: one period."""
    model = arm.model.tree_replace({"opt.iterations": play.iterations})
    function = partial(_advance, play.cables, play.steps_per_period)
    with compiling(f"MJX for {play.num_sims} arms, {play.cables}, {play.iterations} solver iterations"):
        compiled = compile_batch(function, (None, None, 0, 0, 0), model, arm.data, batch, state, target)
    return partial(compiled, model, arm.data)


def _advance(
    cables: CableModel,
    num_steps: int,
    model: mjx.Model,
    home: mjx.Data,
    one: _Simulation,
    state: ArmState,
    target: jax.Array,
) -> tuple[ArmState, jax.Array]:
    """One simulation `num_steps` time steps on, and its joint velocities (num_steps, nv) on the way."""
    model = model.tree_replace({"opt.tolerance": one.tolerance})
    if cables == "limits":
        model = _limited(model, one, target)
    else:
        state = state.replace(strand_commands=target)  # pyright: ignore[reportAttributeAccessIssue]

    def step(state: ArmState, _):
        data = mjx.forward(model, state.placed_in(home))
        force = jnp.where(one.is_balanced, balanced(model, data).qfrc_constraint, data.qfrc_constraint)
        data = mjx.implicit(model, data.replace(qfrc_constraint=force))
        return state.moved_to(data), data.qvel

    return jax.lax.scan(step, state, length=num_steps)


def _limited(model: mjx.Model, one: _Simulation, centres: jax.Array) -> mjx.Model:
    """The model with one simulation's limits at one command; strands are the first tendons."""
    strands = slice(0, len(centres))
    ranges = jnp.stack([centres - one.half_width, centres + one.half_width], axis=1)
    return model.tree_replace(
        {
            "tendon_range": model.tendon_range.at[strands].set(ranges),
            "tendon_solref_lim": model.tendon_solref_lim.at[strands].set(one.solref),
            "tendon_solimp_lim": model.tendon_solimp_lim.at[strands].set(one.solimp),
        }
    )


def _tips(arm: MjxArm, positions: np.ndarray) -> np.ndarray:
    """Tip positions (n, 3) [m] at joint positions (n, nq), by C MuJoCo; NaN where those are not finite."""
    data, tips = mujoco.MjData(arm.host), np.full((len(positions), 3), np.nan)
    for row in np.flatnonzero(np.isfinite(positions).all(axis=1)):
        data.qpos[:] = positions[row]
        mujoco.mj_kinematics(arm.host, data)
        tips[row] = data.site_xpos[arm.tip]
    return tips
