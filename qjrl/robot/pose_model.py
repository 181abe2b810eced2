"""A forward model as a solver gets it: a pytree that is called, cable lengths -> pose, whose numbers are arguments.

Whatever is compiled with a model takes it as a traced argument: models of the same structure share one program. The closed
form, a learned model of a robot and a plain function are called alike, and have nothing else in common.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.config import ConfigError
from qjrl.field_words import show
from qjrl.robot.verbs import Robot, configuration_from_cables, forward_kinematics

PoseFunction = Callable[[jax.Array], jax.Array]
"""Lengths (num_cables,) [m] -> pose (9,) [m, -]."""


@struct.dataclass(eq=False)  # as functions, models are equal to themselves alone: `jax.jit` takes one as it is
class ClosedForm:
    """The nominal closed form of a robot."""

    robot: Any

    def __call__(self, lengths: jax.Array) -> jax.Array:
        """Pose (9,) at cable lengths (num_cables,) [m]."""
        return forward_kinematics(self.robot, configuration_from_cables(self.robot, lengths))


@struct.dataclass
class PlainFunction:
    """A plain function as a model without numbers of its own: what it holds is compiled in, and another one is compiled anew."""

    function: Any = struct.field(pytree_node=False)

    def __call__(self, lengths: jax.Array) -> jax.Array:
        """What the function says of cable lengths (num_cables,) [m]."""
        return self.function(lengths)


def as_model(model: PoseFunction | None) -> PoseFunction | None:
    """The model as a pytree that is called: a plain function is wrapped; None, the closed form, stays None.

    Raises:
        ConfigError: it cannot be called.
    """
    if model is None:
        return None
    if not callable(model):
        raise ConfigError(f"model: got {show(model)}, allowed: what is called with cable lengths and answers a pose")
    return PlainFunction(model) if jax.tree_util.all_leaves([model]) else model


def or_closed_form(robot: Robot, model: PoseFunction | None) -> PoseFunction:
    """The model, or where there is none the robot's closed form."""
    return ClosedForm(robot) if model is None else model


def is_chain(model: PoseFunction) -> bool:
    """Whether a model is a long chain of small operations, as closed forms are and networks are not; see `xla_options`."""
    return getattr(model, "is_chain", False)


def model_poses(model: PoseFunction, lengths: Any) -> np.ndarray:
    """Poses (n, 9) of a model at cable lengths (n, num_cables) [m], on the host."""
    return np.asarray(_model_poses(as_model(model), jnp.asarray(lengths)))


@jax.jit
def _model_poses(model: Any, lengths: jax.Array) -> jax.Array:
    return jax.vmap(model)(lengths)
