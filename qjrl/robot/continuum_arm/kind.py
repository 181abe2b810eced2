"""The continuum arm as a kind of robot: its configuration is the bends theta (cos alpha, sin alpha) [rad], one pair a segment."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import ConfigError
from qjrl.robot.continuum_arm import differential, kinematics, sampling, simulated
from qjrl.robot.continuum_arm.arm import ContinuumArm, arm_from_config
from qjrl.robot.continuum_arm.description import ContinuumArmConfig
from qjrl.robot.continuum_arm.drawing import DRAWING
from qjrl.robot.continuum_arm.particulars import PARTICULARS
from qjrl.robot.kind import Kind
from qjrl.robot.limits import Discs


def home(arm: ContinuumArm) -> jax.Array:
    """The straight arm."""
    return jnp.zeros((arm.num_segments, 2))


def limits(arm: ContinuumArm) -> Discs:
    """theta up to the bend limit, in every direction."""
    return Discs(arm.bend_limit)


def check_bends(arm: ContinuumArm, bends: np.ndarray, where: str) -> None:
    """Refuse bends (n, num_segments, 2) of half a turn and more."""
    sizes = np.linalg.norm(bends, axis=-1)
    if (largest := float(sizes.max())) >= np.pi:
        segment = int(np.argmax(sizes)) % arm.num_segments
        hint = "; in degrees? divide by 57.3" if largest <= 180.0 else ""
        raise ConfigError(
            f"{where}: segment {segment} (the first is 0): got a bend of {largest:.4g} rad, allowed: below pi{hint}"
        )


def motor_force(arm: ContinuumArm, tension: Any) -> Any:
    """Every motor holds one cable."""
    del arm
    return tension


def is_at_strength(arm: ContinuumArm, tension: Any) -> Any:
    """Whether cables of tensions (...,) [N] would break."""
    return tension >= arm.cable_strength


def reach(arm: ContinuumArm) -> float:
    """Length of the straight arm [m]."""
    return float(np.sum(np.asarray(arm.segment_lengths)))


def cable_names(arm: ContinuumArm) -> tuple[str, ...]:
    """ "cable_NUMBER" of every cable, by the number it goes by on the machine."""
    return tuple(f"cable_{number}" for numbers in arm.cable_numbers for number in numbers)


CONTINUUM_ARM = Kind(
    description=ContinuumArmConfig,
    make=arm_from_config,
    home=home,
    limits=limits,
    forward_kinematics=kinematics.forward_kinematics,
    from_unit_cube=sampling.bends_from_unit_cube,
    largest=lambda arm: arm.bend_limit,
    random=sampling.uniform_bends,
    configuration_name="bends",
    senses_configuration=False,
    check=check_bends,
    tip=differential.tip_of,
    at_distance=sampling.bends_at_distance,
    cable_lengths=kinematics.cable_lengths,
    configuration_from_cables=kinematics.bends_from_cables,
    cable_strokes=kinematics.cable_strokes,
    rest=simulated.rest,
    measured=simulated.measured,
    motor_force=motor_force,
    is_at_strength=is_at_strength,
    drawing=DRAWING,
    particulars=PARTICULARS,
    reach=reach,
    cable_names=cable_names,
    strand_names=cable_names,
)
