"""Actor and critic: brax's networks, started so that the deterministic action is exactly zero."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from qjrl.learning.ppo.brax_parts import PPONetworks, make_ppo_networks, running_statistics
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY
from qjrl.learning.ppo.policy import ACTIVATIONS

_MIN_STD = 0.001
"""What brax's NormalTanhDistribution adds to every standard deviation."""


def make_networks(config: PPOConfig, observation_sizes: Mapping[str, int], action_size: int) -> PPONetworks:
    """Actor on `state`, critic on `privileged_state`, a normal distribution squashed by tanh.

    `apply(normaliser, parameters, observation)` of both takes a dict with its own key at least.
    """
    normalise: Any = functools.partial(running_statistics.normalize, max_abs_value=config.observation_clip)
    return make_ppo_networks(
        dict(observation_sizes),
        action_size,
        preprocess_observations_fn=normalise,
        policy_hidden_layer_sizes=config.actor_layers,
        value_hidden_layer_sizes=config.critic_layers,
        activation=ACTIVATIONS[config.activation],
        policy_obs_key=ACTOR_KEY,
        value_obs_key=CRITIC_KEY,
        distribution_type="tanh_normal",
    )


def initial_parameters(
    networks: PPONetworks, initial_std: float, key: jax.Array, starts_at_zero: bool = True
) -> dict[str, Any]:
    """{"policy", "value"}: float32 parameters; the actor's last layer is zero but for its standard deviation.

    Done by hand: brax 0.14.2 takes `mean_kernel_init_fn`, but ignores it for the tanh-normal distribution. Without
    `starts_at_zero` the last layer is as brax makes it.
    """
    key_policy, key_value = jax.random.split(key)
    layers = networks.policy_network.init(key_policy)["params"]
    policy = {"params": start_at_zero(layers, initial_std) if starts_at_zero else layers}
    return {"policy": policy, "value": networks.value_network.init(key_value)}


def start_at_zero(layers: Mapping[str, Any], initial_std: float) -> dict[str, Any]:
    """The layers of an actor with the last one replaced: mean 0 and the same deviation for every observation."""
    last = f"hidden_{len(layers) - 1}"
    zeros = jnp.zeros_like(layers[last]["bias"])
    scale_before_softplus = math.log(math.expm1(initial_std - _MIN_STD))
    bias = zeros.at[len(zeros) // 2 :].set(scale_before_softplus)
    return {**layers, last: {"kernel": jnp.zeros_like(layers[last]["kernel"]), "bias": bias}}
