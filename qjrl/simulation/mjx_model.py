"""The arm in MJX: its import without the lines it prints, single precision, and the model that both users of MJX share."""

import contextlib
import dataclasses
import io

import jax
import mujoco

from qjrl.robot import build_mjcf
from qjrl.robot.quaternion_arm.mjcf import SolverOptions
from qjrl.robot.verbs import Robot

with contextlib.redirect_stdout(io.StringIO()):  # two lines about warp where that is not installed
    from mujoco import mjx

__all__ = ["MjxArm", "load_arm", "mjx", "single_precision"]

# In a batch MJX runs as many iterations as its slowest arm wants, and a tolerance that float32 cannot meet makes that all
# of them: few of both. C needs one iteration of Newton on this model.
SOLVER_ITERATIONS, SOLVER_TOLERANCE = 3, 1e-6
LINE_SEARCH_ITERATIONS = 12
# Dry friction as hard as in C (0.9999) is beyond float32: at rest the solver now and then throws an arm at up to 2.5 rad/s.
# Measured on one joint with friction up to 3 N: with 0.999 at most 0.03 rad/s, and 0.1 mm of creep in 1.2 s; C: 5e-5 rad/s.
FRICTION_IMPEDANCE = 0.999


@dataclasses.dataclass(frozen=True)
class MjxArm:
    """One arm's model on both sides."""

    host: mujoco.MjModel
    """C MuJoCo's, from which MJX's was made."""
    model: mjx.Model
    """MJX's, float32, on JAX's default device."""
    data: mjx.Data
    """One simulation at home: a template to replace states in."""


def load_arm(robot: Robot, options: SolverOptions, strand_friction: float | None = None) -> MjxArm:
    """An arm's model for MJX.

    Args:
        robot: the arm.
        options: numerical settings.
        strand_friction: instead of the robot's [N]. MJX makes friction rows only where this is above 0 here.
    """
    host = mujoco.MjModel.from_xml_string(build_mjcf(robot, options))
    host.opt.iterations, host.opt.ls_iterations = SOLVER_ITERATIONS, LINE_SEARCH_ITERATIONS
    host.opt.tolerance = SOLVER_TOLERANCE
    host.dof_solimp[:, :2] = host.tendon_solimp_fri[:, :2] = FRICTION_IMPEDANCE
    if strand_friction is not None:
        host.tendon_frictionloss[: robot.num_strands] = strand_friction
    with single_precision():
        return MjxArm(host, mjx.put_model(host, impl="jax"), mjx.make_data(host, impl="jax"))


def single_precision() -> contextlib.AbstractContextManager:
    """Around every call into MJX: what is made and compiled inside is float32 and int32, whatever the process uses.

    With x64 on, MJX would compute in float64, and its integers would change their type within a loop.
    """
    return jax.enable_x64(False)
