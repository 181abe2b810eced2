"""The simulated robot that an arm's description stands for: a plant of elastic rods with hidden defects, and where it rests.

No model may see the defects, so nothing but `rest` reads them: kinematics and cables know the nominal arm alone.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qjrl.geometry.pose import pose_from_frame, position_of, rotation_of
from qjrl.geometry.se3 import exp_rotation
from qjrl.robot.at_rest import AtRest
from qjrl.robot.batching import in_batches
from qjrl.robot.continuum_arm.arm import ContinuumArm
from qjrl.robot.continuum_arm.defects import DefectSizes, with_defects
from qjrl.robot.continuum_arm.plant import Plant, nominal_plant
from qjrl.robot.continuum_arm.rest import compiled_rest
from qjrl.robot.continuum_arm.rod import Discretisation

ROWS = 64
"""Rows of the compiled program. Rows search together: with others beside it a row rests within 1e-9 m."""
COUNTS = Discretisation()


def simulated_plant(arm: ContinuumArm) -> Plant:
    """The arm as described, with the draw of defects of its seed."""
    numbers = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), arm)
    plant = nominal_plant(
        length=numbers.segment_lengths,
        anchor_radius=numbers.anchor_radii,
        anchor_directions=np.asarray(numbers.anchor_directions, np.float64),
        bending_stiffness=numbers.bending_stiffness,
        torsional_stiffness=numbers.torsional_stiffness,
        axial_stiffness=numbers.axial_stiffness,
        disc_mass=numbers.disc_mass,
        disc_depth=float(numbers.disc_depth),
        hose_mass=numbers.hose_mass,
        payload=float(numbers.payload),
        payload_height=float(numbers.payload_height),
        cable_stiffness=float(numbers.cable_stiffness),
        pretension=float(numbers.pretension),
        friction=float(numbers.friction_coefficient),
        base_wrap=float(numbers.wrap_angle),
        gravity=numbers.gravity,
    )
    sizes = DefectSizes(
        anchor=float(numbers.anchor_position_error),
        home_length=float(numbers.home_length_error),
        cable_gain=float(numbers.cable_gain_error),
        tip_frame_deg=float(numbers.tip_angle_error_deg),
        preset_bend=float(numbers.preset_bend_error),
    )
    return with_defects(plant, sizes, arm.defects_seed)


def rest(arm: ContinuumArm, lengths: np.ndarray, previous: np.ndarray) -> AtRest:
    """Where the simulated arm rests at cable lengths (n, cables) [m], having come from the previous ones; float64."""
    plant, shape = simulated_plant(arm), (-1, arm.num_segments, arm.cables_per_segment)
    found = in_batches(
        lambda commands, before: compiled_rest(plant, commands, before, COUNTS),
        ROWS,
        lengths.reshape(shape),
        previous.reshape(shape),
    )
    bends = np.stack([found.modes[:, :, 0], found.modes[:, :, COUNTS.bending]], axis=2)
    count = len(lengths)
    return AtRest(
        pose=found.pose,
        configuration=bends,
        strand_tension=found.tension.reshape(count, -1),
        positions=found.modes.reshape(count, -1),
        has_rested=found.converged,
    )


def measured(arm: ContinuumArm, key: jax.Array, pose: Float[Array, "9"]) -> Float[Array, "9"]:
    """A pose as it is measured: noise on its position, and on its rotation about the tip's axes."""
    key_position, key_angle = jax.random.split(key)
    shift = arm.measured_position_error * jax.random.normal(key_position, (3,))
    turn = exp_rotation(jnp.radians(arm.measured_angle_error_deg) * jax.random.normal(key_angle, (3,)))
    return pose_from_frame(position_of(pose) + shift, rotation_of(pose) @ turn)
