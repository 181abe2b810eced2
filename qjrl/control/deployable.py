"""The controller as functions of named arrays: what is exported, and what an export is compared with."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from qjrl.artifacts import ArtifactError
from qjrl.control import controller
from qjrl.control.controller import ControllerConfig
from qjrl.control.motors import action_size
from qjrl.control.observations import ControlState
from qjrl.learning.ppo.policy import Policy, deterministic_action
from qjrl.robot.kinds import configuration_shape
from qjrl.robot.verbs import Robot

Arrays = dict[str, jax.Array]


@dataclasses.dataclass(frozen=True)
class ControllerFunctions:
    """A controller of one arm; its state is a dict by the names of `ControlState`."""

    begin: Callable[[jax.Array, jax.Array, jax.Array], Arrays]
    """Target (9,), base command (num_cables,) [m], first reading (segments, 2) [rad] -> state."""
    step: Callable[[Mapping[str, Any], jax.Array], Arrays]
    """State and reading, the first one again at first -> next state; its `command` (num_cables,) [m] is for the motors."""


def controller_functions(config: ControllerConfig, robot: Robot, policy: Policy) -> ControllerFunctions:
    """Base command, dither, feedback, the deterministic policy and all limits, in the precision of the robot's numbers."""

    def begin(target: jax.Array, base_lengths: jax.Array, reading: jax.Array) -> Arrays:
        return _named(controller.prepare(config, robot, target, base_lengths, reading))

    def step(state: Mapping[str, Any], reading: jax.Array) -> Arrays:
        act = lambda observation: deterministic_action(policy, observation)  # noqa: E731
        return _named(controller.tick(config, robot, act, _state_of(config, state), reading))

    return ControllerFunctions(begin, step)


def checked_policy(config: ControllerConfig, robot: Robot, policy: Policy) -> Policy:
    """The policy, if its sizes are the controller's.

    Raises:
        ArtifactError: it was trained on other observations or other actions.
    """
    numbers = jnp.zeros(9), jnp.zeros(robot.num_cables), jnp.zeros(configuration_shape(robot))
    seen = jax.eval_shape(
        lambda *task: controller.observation(config, robot, controller.prepare(config, robot, *task)), *numbers
    )
    action = policy.layers[f"hidden_{len(policy.layers) - 1}"]["bias"].shape[0] // 2
    sizes, expected = (len(policy.mean), action), (seen.shape[0], action_size(config.residual, robot))
    if sizes != expected:
        raise ArtifactError(
            f"policy: sees {sizes[0]} numbers and gives {sizes[1]}, the controller has {expected[0]} and {expected[1]}; "
            "run stages=[policy,deploy]"
        )
    return policy


# Constants of the configuration, and what `tick` computes from the reading before anything asks for it.
_LEFT_OUT = ("gains", "estimated", "tip_error")


def _named(state: ControlState) -> Arrays:
    names = [field.name for field in dataclasses.fields(state) if field.name not in _LEFT_OUT]
    return {name: getattr(state, name) for name in names}


def _state_of(config: ControllerConfig, arrays: Mapping[str, Any]) -> ControlState:
    dtype, reading = arrays["command"].dtype, arrays["reading"]
    gains = controller.gains_of(config, dtype)
    return ControlState(gains=gains, estimated=jnp.zeros_like(reading), tip_error=jnp.zeros(6, dtype), **arrays)
