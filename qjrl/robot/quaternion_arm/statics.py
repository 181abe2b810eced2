"""Where an arm rests when its motors hold, gravity and springs included, and what would move it from there.

Its half angles are those of least energy: of gravity, hinges and strands. From where a perfect arm would be, steps
against the stiffness of springs and strands alone lead there; the slopes take all of it.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.geometry import cholesky
from qjrl.robot.equilibrium import Equilibrium
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.cables import bends_from_cables, strand_commands, strand_lengths
from qjrl.robot.quaternion_arm.coordinates import bends_from_half_angles, half_angles
from qjrl.robot.quaternion_arm.dynamics import hinge_stiffness
from qjrl.robot.quaternion_arm.joint import joint_height
from qjrl.robot.quaternion_arm.kinematics import frames

STEPS = 12
# Of one half angle in one step [rad].
_LARGEST_STEP = 0.2


def equilibrium(arm: QuaternionArm, lengths: jax.Array) -> Equilibrium:
    """Of an arm as described, holding cable lengths (num_cables,) [m]. Where no pose is stable it is not a number."""
    angles, nothing = _rest(arm, lengths, STEPS), jnp.zeros(3, lengths.dtype)
    torque = partial(_torque, arm, strand_commands(arm, lengths))
    by_angle, by_cause = jax.jacfwd(torque, (0, 1))(angles, nothing)
    moved = _solve(-by_angle, jnp.concatenate([by_cause, -_slope(arm, angles).T], axis=1))
    slopes = jax.jacfwd(_bends)(angles) @ moved
    return Equilibrium(_bends(angles), slopes[..., 0], slopes[..., 1:3], slopes[..., 3:])


def strand_tension(arm: QuaternionArm, lengths: jax.Array, steps: int = STEPS) -> jax.Array:
    """(strands,) [N] at rest, 0 where slack, of an arm as described that holds cable lengths (num_cables,) [m].

    Joint stops are left out. The paper's arm settles within 0.015 N of it (at pretensions of 15 and 34 N, bends uniform up to
    the limit). Where many strands are slack the steps stop short, and the taut ones are up to 1.6 N off; that one is slack was
    right to 0.01 N all the same.
    """
    stretch = strand_lengths(arm, _bends(_rest(arm, lengths, steps))) - strand_commands(arm, lengths)
    return jnp.clip(arm.strand_stiffness * stretch, 0.0, arm.strand_strength)


def is_at_strength(arm: QuaternionArm, tension: Any) -> Any:
    """Whether strands of such tensions (...,) [N] would break. No model lets a strand carry more than its strength, so
    reaching it is what tells, but for the rounding of single precision."""
    return tension >= (1.0 - 1e-6) * arm.strand_strength


def _rest(arm: QuaternionArm, lengths: jax.Array, steps: int) -> jax.Array:
    """Half angles (2 segments,) at rest [rad]. With all strands taut an error shrinks a hundredfold a step."""
    commands, nothing = strand_commands(arm, lengths), jnp.zeros(3, lengths.dtype)
    stiffness = jnp.diag(jnp.asarray(hinge_stiffness(arm), lengths.dtype))

    def improve(_, angles: jax.Array) -> jax.Array:
        along = _slope(arm, angles)
        held = stiffness + arm.strand_stiffness * along.T @ along
        change = _solve(held, _torque(arm, commands, angles, nothing))
        return angles + jnp.clip(change, -_LARGEST_STEP, _LARGEST_STEP)

    first = jax.vmap(half_angles)(bends_from_cables(arm, lengths))
    return jax.lax.fori_loop(0, steps, improve, first.reshape(-1))


def _slope(arm: QuaternionArm, angles: jax.Array) -> jax.Array:
    """(strands, 2 segments) of the strands' lengths by the half angles [m/rad]."""
    return jax.jacfwd(lambda angles: strand_lengths(arm, _bends(angles)))(angles)


def _torque(arm: QuaternionArm, commands: jax.Array, angles: jax.Array, causes: jax.Array) -> jax.Array:
    """(2 segments,) towards less energy, by half angle [N m]."""
    return -jax.grad(_energy, 2)(arm, commands, angles, causes)


def _energy(arm: QuaternionArm, commands: jax.Array, angles: jax.Array, causes: jax.Array) -> jax.Array:
    """[J] at half angles (2 segments,) [rad]; causes: logarithm of the gain, tilt about x and about y [rad]."""
    down = jnp.asarray(arm.gravity, angles.dtype)
    down = down + jnp.cross(jnp.concatenate([causes[1:], jnp.zeros(1, angles.dtype)]), down)
    gain = jnp.exp(causes[0]) * arm.strand_stiffness
    stretch = jnp.maximum(strand_lengths(arm, _bends(angles)) - commands, 0.0)
    spring = jnp.minimum(stretch, arm.strand_strength / gain)  # beyond it the servo pulls with all its strength
    strands = jnp.sum(gain * (0.5 * spring**2 + spring * (stretch - spring)))
    hinges = 0.5 * jnp.sum(jnp.asarray(hinge_stiffness(arm), angles.dtype) * angles**2)
    return strands + hinges - down @ _first_moment(arm, _bends(angles))


def _first_moment(arm: QuaternionArm, bends: jax.Array) -> jax.Array:
    """(3,) sum of all masses times where they are [kg m], payload included; chords and links as in `mjcf`."""
    joints = np.repeat(np.arange(arm.num_segments), arm.joints_per_segment)
    plates, ends = frames(arm, bends)[:, :3].reshape(arm.num_joints, 2, 3).swapaxes(0, 1)
    starts = jnp.concatenate([jnp.zeros((1, 3), bends.dtype), ends[:-1]])
    heights = jax.vmap(lambda bend: joint_height(arm, bend))(bends)[joints]
    along = 0.5 * joint_height(arm, jnp.zeros(2, bends.dtype)) / heights  # a chord's mass stays half a home height up
    chords, links = starts + along[:, None] * (plates - starts), 0.5 * (plates + ends)
    masses = arm.joint_mass * chords + arm.link_mass * links
    return jnp.sum(masses, axis=0) + arm.payload * ends[-1]


def _solve(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """x with matrix x = right, the matrix symmetric and positive definite, as the stiffness of a stable pose is."""
    return cholesky.solve(cholesky.factor(matrix), right)


def _bends(angles: jax.Array) -> jax.Array:
    return bends_from_half_angles(angles.reshape(-1, 2))
