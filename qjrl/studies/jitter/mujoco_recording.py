"""Joint velocities at every time step of commands played in C MuJoCo."""

import mujoco
import numpy as np
from mujoco import batch

from qjrl.cores import usable_cores
from qjrl.robot import joint_positions
from qjrl.robot.verbs import home
from qjrl.studies.jitter.cable_models import Play, Recording


def record_mujoco(play: Play, tip_force: np.ndarray | None = None, num_threads: int = 0) -> Recording:
    """Play all simulations of `play` side by side.

    Args:
        tip_force: (n, 3) that acts on the tip all the time, in the base's axes [N]; default: none.
        num_threads: 0 = all cores.
    """
    model = mujoco.MjModel.from_xml_string(play.mjcf)
    sims = batch.Batch(model, play.num_sims, num_threads or usable_cores())
    velocities, tip = (
        sims.bind("qvel"),
        sims.site("tip").xpos,
    )  # before anything runs: what is bound later is not filled
    _begin(play, model, sims)
    targets, recorded = play.strand_targets, []
    has_failed = np.zeros(play.num_sims, bool)
    for target in targets:
        _command(play, sims, target)
        if tip_force is not None:
            _push(model, sims, tip_force)
        for _ in range(play.steps_per_period):
            has_failed |= _step(sims)
            recorded.append(np.where(has_failed[:, None], np.nan, velocities).astype(np.float32))
    sims.forward()
    return Recording(np.stack(recorded, axis=1), np.where(has_failed[:, None], np.nan, tip.reshape(-1, 3)))


def _begin(play: Play, model: mujoco.MjModel, sims: batch.Batch) -> None:
    sims.bind("qpos")[:] = np.asarray(joint_positions(play.robot, home(play.robot)))
    sims.expand("opt.tolerance")[:] = play.tolerance
    if play.cables == "limits":
        strands = slice(0, play.robot.num_strands)
        sims.expand("tendon_solref_lim")[:, strands] = play.limits.solref[:, None]
        sims.expand("tendon_solimp_lim")[:, strands] = play.limits.solimp[:, None]


def _command(play: Play, sims: batch.Batch, target: np.ndarray) -> None:
    if play.cables == "limits":
        sims.expand("tendon_range")[:, : play.robot.num_strands] = play.limits.around(target)
    else:
        sims.ctrl[:] = target


def _push(model: mujoco.MjModel, sims: batch.Batch, force: np.ndarray) -> None:
    """A force on the tip is one on its body's centre of mass and a moment about it."""
    body = model.site_bodyid[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tip")]
    lever = sims.site("tip").xpos.reshape(-1, 3) - sims.bind("xipos")[:, body]
    sims.bind("xfrc_applied")[:, body] = np.concatenate([force, np.cross(lever, force)], axis=1)


def _step(sims: batch.Batch) -> np.ndarray:
    """(n,) which simulations MuJoCo could not step, now or before."""
    failed = sims.warning[:, :, 1].any(axis=1)
    try:
        sims.step()
    except batch.SimulationError as error:
        failed[list(error.ids)] = True
    return failed | sims.warning[:, :, 1].any(axis=1)
