"""Where the arm can run along a path: chains of descents on the closed form from waypoint to waypoint."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.control.path.errors import pose_residual
from qjrl.control.path.paths import Constraint, PosePath
from qjrl.robot import cable_lengths
from qjrl.robot.kinds import kind_of
from qjrl.robot.pose_model import ClosedForm
from qjrl.robot.verbs import Robot, within_limits


def chained(robot: Robot, path: PosePath, num_starts: int, seed: int) -> np.ndarray:
    """Cable lengths (n, cables) [m] of the chain that misses the waypoints of a path least and then travels least.

    Args:
        num_starts: chains, the first from home, the others from random configurations.
    """
    keys = jax.random.split(jax.random.key(seed), num_starts)
    kind = kind_of(robot)
    starts = jax.vmap(lambda key: kind.random(robot, key))(keys).at[0].set(kind.home(robot))
    targets = np.concatenate([np.repeat(path.pose[:1], _ARRIVAL, axis=0), path.pose])
    lengths, missed = (np.asarray(part) for part in _run_chains(path.constraint, robot, starts, targets))
    lengths, missed = lengths[:, _ARRIVAL:], missed[:, _ARRIVAL:].max(axis=1)
    travel = np.linalg.norm(np.diff(lengths, axis=1), axis=2).sum(axis=1) + np.linalg.norm(lengths, axis=2).max(axis=1)
    return lengths[np.lexsort((travel, np.round(missed, 5)))[0]]


@functools.partial(jax.jit, static_argnums=0)
def _run_chains(constraint: Constraint, robot: Robot, starts: jax.Array, targets: jax.Array):
    """Cable lengths (starts, n, cables) of chains of descents from target to target, and their residuals (starts, n) [m]."""
    nominal, shape = ClosedForm(robot), starts.shape[1:]

    def residual(flat, target):
        error = pose_residual(constraint, nominal(cable_lengths(robot, flat.reshape(shape))), target)
        return error, error

    def step(flat, target):
        jacobian, error = jax.jacfwd(residual, has_aux=True)(flat, target)
        squared = jnp.sum(error**2)  # damping by it keeps far steps short and near ones Newton's
        damped = jacobian.T @ jacobian + (squared + 1e-10) * jnp.eye(len(flat))
        moved = (flat - jnp.linalg.solve(damped, jacobian.T @ error)).reshape(shape)
        return within_limits(robot, moved).reshape(-1), jnp.sqrt(squared)

    def reach(flat, target):
        flat, errors = jax.lax.scan(lambda flat, _: step(flat, target), flat, length=_STEPS)
        return flat, (cable_lengths(robot, flat.reshape(shape)), errors[-1])

    return jax.vmap(lambda start: jax.lax.scan(reach, start.reshape(-1), targets)[1])(starts)


# Steps of a descent, and descents to the first waypoint.
_STEPS, _ARRIVAL = 6, 12
