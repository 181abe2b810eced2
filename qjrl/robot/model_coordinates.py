"""What goes into a learned model and what comes out of it: lengths or the nominal configuration; a pose, or a correction.

The corrected form works in the robot's own configuration: the nominal one of the lengths goes in, the correction to it
comes out (what joint encoders measure), and the closed-form kinematics makes the pose of them. Sag, strand stretch and
friction bend the joints; the links stay rigid, so nothing is lost, and a model learns eight small smooth numbers of the
quaternion-joint arm instead of its whole kinematics. A third form lies between the two, to tell what comes in from what
goes out: scaled lengths go in, the correction comes out.

Where a kind of robot does not sense its configuration, the correction is that of the nominal pose: shift and rotation vector.
"""

from collections.abc import Mapping
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.pose_coding import decode, encode
from qjrl.robot.verbs import Robot, cable_strokes, configuration_from_cables, forward_kinematics

Form = Literal["paper", "corrected_from_lengths", "corrected"]
""""paper": scaled lengths -> pose; "corrected": nominal configuration -> its correction, then the kinematics;
"corrected_from_lengths": scaled lengths -> the same correction."""
Rows = Mapping[str, np.ndarray]
"""Columns of a data set."""


def model_inputs(robot: Robot, form: str, lengths: jax.Array) -> jax.Array:
    """What enters the model, scaled to [-1, 1], from cable lengths (num_cables,) [m]."""
    if form in ("paper", "corrected_from_lengths"):
        return lengths / cable_strokes(robot)
    return (configuration_from_cables(robot, lengths) / kind_of(robot).largest(robot)).reshape(-1)


def model_pose(robot: Robot, form: str, lengths: jax.Array, answer: jax.Array) -> jax.Array:
    """Pose (9,) from the model's answer at cable lengths (num_cables,) [m]."""
    if form == "paper":
        return answer
    nominal = configuration_from_cables(robot, lengths)
    if not kind_of(robot).senses_configuration:
        return decode(_CODING, forward_kinematics(robot, nominal), answer)
    return forward_kinematics(robot, nominal + answer.reshape(nominal.shape))


def num_answers(robot: Robot, form: str) -> int:
    """How many numbers the model answers."""
    if form == "paper":
        return 9
    return num_coordinates(robot) if kind_of(robot).senses_configuration else 6


def model_targets(robot: Robot, form: str, data: Rows) -> jax.Array:
    """What the model shall answer for rows of a data set: poses, or corrections of the configuration; (n, answers)."""
    if form == "paper":
        return jnp.asarray(data["pose"])
    nominal = jax.vmap(lambda lengths: configuration_from_cables(robot, lengths))(jnp.asarray(data["cable_lengths"]))
    if not kind_of(robot).senses_configuration:
        return _lacking(robot, nominal, jnp.asarray(data["pose"]))
    return (jnp.asarray(data[kind_of(robot).configuration_name]) - nominal).reshape(len(nominal), -1)


_CODING = "split"


@jax.jit
def _lacking(robot: Robot, nominal: jax.Array, poses: jax.Array) -> jax.Array:
    """(n, 6) what nominal configurations (n, ...) lack of poses (n, 9)."""
    return jax.vmap(lambda one, pose: encode(_CODING, forward_kinematics(robot, one), pose))(nominal, poses)
