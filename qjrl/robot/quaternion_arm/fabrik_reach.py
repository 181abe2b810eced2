"""The inner iteration of FABRIK: forward and backward reaching (paper 000, section 3.1, Eqs. 8-12, Fig. 4).

It gives the tip its position and its pointing direction, five degrees of freedom; the roll is left to the outer one.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int

from qjrl.geometry.rotations import safe_norm
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.fabrik_model import VirtualArm, angle_between, segment_lengths, stack


@struct.dataclass
class Goal:
    """What the tip is asked for."""

    position: Float[Array, "3"]
    """P_d [m]."""
    x_axis: Float[Array, "3"]
    """X_d."""
    z_axis: Float[Array, "3"]
    """Z_d."""


def goal_of(target: Float[Array, "9"]) -> Goal:
    """P_d, X_d and Z_d of a pose [m, -]."""
    return Goal(target[:3], target[3:6], jnp.cross(target[3:6], target[6:9]))


def reach(
    robot: QuaternionArm, arm: VirtualArm, goal: Goal, tolerance: float, iterations: int
) -> tuple[VirtualArm, Int[Array, ""]]:
    """Reaches forward and backward until the tip is within `tolerance` [m] of P_d; the arm and the iterations spent."""

    def is_off(carry) -> jax.Array:
        number, arm = carry
        return (number == 0) | ((number < iterations) & (tip_distance(arm, goal) > tolerance))

    def once(carry):
        number, arm = carry
        return number + 1, reach_backward(robot, reach_forward(robot, arm, goal), goal)

    number, arm = jax.lax.while_loop(is_off, once, (jnp.zeros((), jnp.int32), arm))
    return arm, number


def tip_distance(arm: VirtualArm, goal: Goal) -> Float[Array, ""]:
    """From P_e of the last segment to P_d [m]."""
    return safe_norm(arm.ends[-1] - goal.position)


def reach_forward(robot: QuaternionArm, arm: VirtualArm, goal: Goal) -> VirtualArm:
    """From the tip to the base, Fig. 4b-c: the tip is put on the goal, each Z_b points from the P_j before it.

    The paper does not say where the first segment's Z_b points, before which there is no P_j: ours stays upright.
    """
    end, end_direction, rows = goal.position, goal.z_axis, []
    for k in reversed(range(robot.num_segments)):
        count = robot.joints_per_segment[k]
        _, after = segment_lengths(robot, count, arm.angles[k])
        joint = end - after * end_direction  # Eq. 8
        base_direction = _direction(arm.joints[k - 1], joint, arm.base_directions[k]) if k else _upright(goal)  # Eq. 9
        angle = angle_between(end_direction, base_direction) / count  # Eq. 10, divided by m_k
        before, after = segment_lengths(robot, count, angle)
        joint = end - after * end_direction  # Eq. 11
        base = joint - before * base_direction  # Eq. 12
        rows.append(VirtualArm(base, joint, end, base_direction, end_direction, angle))
        end, end_direction = base, base_direction
    return stack(rows[::-1])


def reach_backward(robot: QuaternionArm, arm: VirtualArm, goal: Goal) -> VirtualArm:
    """From the base to the tip, Fig. 4d-e: the same with the base put at [0, 0, 0], each Z_e points to the P_j after it.

    The last segment's Z_e, after which there is no P_j, stays Z_d (ours).
    """
    base, base_direction, rows = jnp.zeros_like(goal.position), _upright(goal), []
    for k, count in enumerate(robot.joints_per_segment):
        before, _ = segment_lengths(robot, count, arm.angles[k])
        joint = base + before * base_direction
        is_last = k == robot.num_segments - 1
        end_direction = goal.z_axis if is_last else _direction(joint, arm.joints[k + 1], arm.end_directions[k])
        angle = angle_between(end_direction, base_direction) / count
        before, after = segment_lengths(robot, count, angle)
        joint = base + before * base_direction
        end = joint + after * end_direction
        rows.append(VirtualArm(base, joint, end, base_direction, end_direction, angle))
        base, base_direction = end, end_direction
    return stack(rows)


def _upright(goal: Goal) -> jax.Array:
    """Z_b of the first segment, whose base is fixed."""
    return jnp.array([0.0, 0.0, 1.0], goal.position.dtype)


def _direction(start: jax.Array, end: jax.Array, fallback: jax.Array) -> jax.Array:
    """Unit vector from one point to another; where they coincide, the direction that was."""
    distance = safe_norm(end - start)
    is_apart = distance > _COINCIDE
    return jnp.where(is_apart, (end - start) / jnp.where(is_apart, distance, 1.0), fallback)


# Distance below which two points give no direction [m].
_COINCIDE = 1e-12
