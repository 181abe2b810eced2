"""What `describe` says of this arm alone: its joints, its loops' common part, and where its description is doubtful."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.robot.particulars import Particulars, Row
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.cables import strand_lengths
from qjrl.robot.quaternion_arm.joint import angles_of_bends
from qjrl.robot.quaternion_arm.sampling import planar_bends

# A loop whose mean strand length grows by more when bent [m] loads its strands by more than the pretension usually is.
_MUCH_STRETCH = 0.002
# Bend of a whole segment [deg] at which the lines through its ends meet nowhere (paper 000, Eqs. 4-7).
_DIVERGENCE_DEG = 180.0


def summary(arm: QuaternionArm) -> str:
    """Segments, joints and cables."""
    counts = ", ".join(map(str, arm.joints_per_segment))
    return (
        f"{arm.num_segments} segments of {counts} {arm.joint_model} quaternion joints, {arm.num_cables} cables of two "
        "strands each"
    )


def own(arm: QuaternionArm, bends: np.ndarray) -> dict[str, Any]:
    """Counts, the bend limit, and half the sum of each loop's two strands relative to home [m]: what a motor cannot give."""
    lengths = jax.jit(jax.vmap(lambda row: strand_lengths(arm, row)))(jnp.asarray(bends))
    change = np.asarray(lengths - strand_lengths(arm, jnp.zeros((arm.num_segments, 2))))
    common = (change[:, 0::2] + change[:, 1::2]) / 2.0
    return {
        "joint_model": arm.joint_model,
        "segments": list(arm.joints_per_segment),
        "joints": arm.num_joints,
        "bend_limit_deg": arm.config.joint.bend_limit_deg,
        "strand_common_part": [float(common.min()), float(common.max())],
    }


def rows(numbers: Mapping[str, Any]) -> list[Row]:
    """Joints, bends, and how far a loop stretches."""
    low, high = numbers["strand_common_part"]
    return [
        ("joints", f"{numbers['joints']} {numbers['joint_model']} ones {numbers['segments']}"),
        ("bends", f"up to {numbers['bend_limit_deg']:.0f}° a joint"),
        ("loop stretch when bent", f"{1e3 * low:.2f} to {1e3 * high:.2f} mm"),
    ]


def under_load(arm: QuaternionArm, settled: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The largest bend of a joint."""
    del arm
    return {"largest_bend_deg": float(np.degrees(angles_of_bends(settled["bends"]).max()))}


def warnings(arm: QuaternionArm, numbers: Mapping[str, Any]) -> list[str]:
    """Near the stop; a joint that does not suit one motor a loop; segments that FABRIK cannot treat."""
    lines, joint = [], arm.config.joint
    if (bent := numbers.get("largest_bend_deg", 0.0)) > joint.bend_limit_deg + 0.5 * joint.stop_margin_deg:
        lines.append(f"joints bend to {bent:.1f} deg under load: near the stop")
    if (stretch := numbers["strand_common_part"][1]) > _MUCH_STRETCH:
        lines.append(
            f"loops stretch by {1e3 * stretch:.1f} mm when bent: this joint's k and d do not suit one motor a loop"
        )
    limit = joint.bend_limit_deg
    return lines + [
        f"segment {segment} bends to {count} x {limit:g} = {count * limit:g} deg: FABRIK's virtual lengths diverge at "
        f"{_DIVERGENCE_DEG:g} deg"
        for segment, count in enumerate(arm.joints_per_segment, start=1)
        if count * limit >= _DIVERGENCE_DEG
    ]


def extreme(arm: QuaternionArm, numbers: jax.Array) -> jax.Array:
    """Bends in one plane: the boundary of what a symmetric arm reaches lies there."""
    return planar_bends(arm, numbers[: arm.num_segments], jnp.zeros(()))


PARTICULARS = Particulars(summary, own, rows, under_load, warnings, extreme)
