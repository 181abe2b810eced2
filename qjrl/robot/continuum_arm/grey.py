"""The arm with what gravity, unequal cables and friction do to it in closed form: a few dozen numbers that poses tell (ours).

Every segment bends by a linear map of its nominal bend, and yields to the weight of all that lies beyond it: to the moment at its
middle by bending and twisting, to the force across it by shearing, for its cables hold its disc nearly parallel. What yields
moves the weights, so that a few passes are made. Friction along the cables adds to the bend by the way each cable moved last.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from qjrl.geometry.pose import pose_from_frame
from qjrl.geometry.se3 import exp_rotation
from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.kinematics import bends_from_cables
from qjrl.robot.continuum_arm.segment import segment_pose

PASSES = 3
"""From shape to weights and back."""
REVERSAL_TRAVEL = 5e-4
"""Travel of a cable after which its friction has turned round, to 76 % [m]."""


@struct.dataclass
class GreyNumbers:
    """What is fitted; S segments."""

    gain: Any
    """(S, 2, 2) of the bends."""
    offset: Any
    """(S, 2) of the bends [rad]."""
    compliance: Any
    """(3,) logarithms of what a segment yields by: bending [rad/(N m)], shearing [m/N], twisting [rad/(N m)]."""
    softening: Any
    """(4,) relative change of compliance with theta^2: bending in the plane of the bend and across it, shearing, twisting."""
    mass: Any
    """(2,) logarithms of payload and disc [kg]."""
    payload_centre: Any
    """(3,) in the frame of the tip's disc [m]."""
    tip_rotation: Any
    """(3,) rotation vector of the measured frame in the tip's disc [rad]."""
    friction: Any
    """() length that a cable of wrap angle 1 lacks when it moved last by paying out [m]."""


def prior_mean(arm: ContinuumArm) -> GreyNumbers:
    """What the description says: compliances of its rods held by its cables, masses, no defects."""
    count, per_segment = arm.num_segments, arm.cables_per_segment
    length, radius = jnp.mean(jnp.asarray(arm.segment_lengths)), jnp.mean(jnp.asarray(arm.anchor_radii))
    bending = arm.bending_stiffness / length + 0.5 * per_segment * arm.cable_stiffness * radius**2
    shearing = 12.0 * arm.bending_stiffness / length**3 + per_segment * arm.pretension / length
    twisting = arm.torsional_stiffness / length + per_segment * arm.pretension * radius**2 / length
    return GreyNumbers(
        gain=jnp.broadcast_to(jnp.eye(2), (count, 2, 2)),
        offset=jnp.zeros((count, 2)),
        compliance=-jnp.log(jnp.stack([bending, shearing, twisting])),
        softening=jnp.zeros(4),
        mass=jnp.log(jnp.array([arm.payload + _LEAST_MASS, arm.disc_mass + _LEAST_MASS])),
        payload_centre=jnp.zeros(3).at[2].set(arm.payload_height),
        tip_rotation=jnp.zeros(3),
        friction=jnp.zeros(()),
    )


def prior_spread(arm: ContinuumArm) -> GreyNumbers:
    """Standard deviations of the numbers about `prior_mean`, ours."""
    like = prior_mean(arm)
    sizes = {
        "gain": 0.05,
        "offset": 0.03,
        "compliance": 0.7,
        "softening": 0.5,
        "mass": 0.3,
        "payload_centre": 0.01,
        "tip_rotation": 0.01,
        "friction": 0.003,
    }
    return GreyNumbers(**{name: jnp.full_like(getattr(like, name), size) for name, size in sizes.items()})


def grey_pose(
    arm: ContinuumArm, numbers: GreyNumbers, lengths: Float[Array, "cables"], rubbing: Any = None
) -> jax.Array:
    """Pose (9,) of the tip at cable lengths [m].

    Args:
        rubbing: (S, 2) of `rubbing_of`, where it is known which way the cables moved last; None: none of it.
    """
    bends = jnp.einsum("sij,sj->si", numbers.gain, bends_from_cables(arm, lengths)) + numbers.offset
    if rubbing is not None:
        bends = bends + numbers.friction * rubbing
    shape = _Shape(bends, jnp.zeros_like(bends), jnp.zeros(arm.num_segments))
    again = lambda shape, _: (_yielded(arm, numbers, bends, _frames(arm, shape)), None)  # noqa: E731
    shape, _ = jax.lax.scan(again, shape, length=PASSES)  # in a row it takes three times as long to compile
    position, rotation = _frames(arm, shape).ends[-1]
    return pose_from_frame(position, rotation @ exp_rotation(numbers.tip_rotation))


def rubbing_of(arm: ContinuumArm, lengths: Float[Array, "cables"], previous: Float[Array, "cables"]) -> jax.Array:
    """(S, 2) bend [rad] for each metre of `GreyNumbers.friction`: sum over cables of sign, wrap angle and direction."""
    shape = (arm.num_segments, arm.cables_per_segment)
    signs = jnp.tanh((lengths - previous) / REVERSAL_TRAVEL).reshape(shape)
    angles = jnp.linalg.norm(bends_from_cables(arm, lengths) + 1e-12, axis=1)
    wrap = arm.wrap_angle + jnp.cumsum(angles) - angles
    pull = jnp.einsum("sc,scd->sd", signs, arm.anchor_directions)
    return wrap[:, None] * pull / (2.0 * jnp.asarray(arm.anchor_radii)[:, None])


@struct.dataclass
class _Shape:
    """Of all segments: bend (S, 2) [rad]; shear (S, 2) [m] and twist (S,) [rad] in the frame of its middle."""

    bends: Any
    shear: Any
    twist: Any


@dataclasses.dataclass(frozen=True)
class _Frames:
    """Position and rotation of all middles and ends, in the base frame."""

    middles: list[tuple[jax.Array, jax.Array]]
    ends: list[tuple[jax.Array, jax.Array]]


def _frames(arm: ContinuumArm, shape: _Shape) -> _Frames:
    """Half an arc, what it yields by at its middle, the other half."""
    position, rotation, middles, ends = jnp.zeros(3), jnp.eye(3), [], []
    for segment in range(arm.num_segments):
        half, turn = segment_pose(0.5 * jnp.asarray(arm.segment_lengths)[segment], 0.5 * shape.bends[segment])
        middle, across = position + rotation @ half, rotation @ turn
        shear, twist = shape.shear[segment], shape.twist[segment]
        middles.append((middle + 0.5 * (across[:, :2] @ shear), across))
        twisted = across @ exp_rotation(jnp.zeros(3).at[2].set(twist))
        position, rotation = middle + across[:, :2] @ shear + twisted @ half, twisted @ turn
        ends.append((position, rotation))
    return _Frames(middles, ends)


def _yielded(arm: ContinuumArm, numbers: GreyNumbers, bends: jax.Array, frames: _Frames) -> _Shape:
    """The shape under the weights where they lie now."""
    gravity = jnp.asarray(arm.gravity)
    payload, disc = jnp.exp(numbers.mass)
    tip, tip_rotation = frames.ends[-1]
    weights = [(payload, tip + tip_rotation @ numbers.payload_centre)]
    bending, shearing, twisting = jnp.exp(numbers.compliance)
    shapes = []
    for segment in reversed(range(arm.num_segments)):
        (middle, turn), (end, end_turn) = frames.middles[segment], frames.ends[segment]
        weights.append((disc, end - arm.disc_depth * end_turn[:, 2]))
        force = sum(mass for mass, _ in weights) * gravity
        moment = sum(mass * jnp.cross(centre - middle, gravity) for mass, centre in weights)
        weights.append((arm.hose_mass, middle))  # its own weight acts at the middle: no moment there, half a force
        force, moment = turn.T @ (force + 0.5 * arm.hose_mass * gravity), turn.T @ moment
        bend = bends[segment]
        squared = jnp.sum(bend**2)
        soft = jnp.exp(numbers.softening * squared)
        more = bending * jnp.stack([moment[1], -moment[0]])
        along = bend * jnp.dot(bend, more) / (squared + 1e-12)
        shapes.append(
            (
                bend + soft[0] * along + soft[1] * (more - along),
                soft[2] * shearing * force[:2],
                soft[3] * twisting * moment[2],
            )
        )
    bent, shear, twist = zip(*reversed(shapes), strict=True)
    return _Shape(jnp.stack(bent), jnp.stack(shear), jnp.stack(twist))


# Below it a mass has no logarithm worth fitting [kg].
_LEAST_MASS = 0.01
