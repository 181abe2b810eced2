"""One PPO update: advantages once, then epochs of minibatches, compiled as a whole."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from qjrl.learning.ppo.advantages import advantages_and_returns
from qjrl.learning.ppo.brax_parts import PPONetworks
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import CRITIC_KEY
from qjrl.learning.ppo.loss import Batch, ppo_loss
from qjrl.learning.ppo.mesh import ENVS
from qjrl.learning.ppo.normaliser import Normaliser
from qjrl.learning.ppo.rollout import Rollout


@struct.dataclass
class Learner:
    """What the gradient steps change."""

    parameters: Any
    """{"policy", "value"}."""
    optimiser_state: Any
    learning_rate: Any
    """The actor's."""


def make_learner(config: PPOConfig, parameters: dict[str, Any]) -> Learner:
    """A learner that has not learned anything yet."""
    return Learner(parameters, optax.scale_by_adam().init(parameters), jnp.float32(config.learning_rate))


def make_update(
    networks: PPONetworks, config: PPOConfig, mesh: Mesh | None = None
) -> Callable[..., tuple[Learner, dict[str, jax.Array]]]:
    """The update: (learner, normaliser, rollout, last observation, key, moves actor) -> (learner, metrics).

    Where the actor is not moved, the critic alone learns. On a mesh the rows of every minibatch are cut over the devices.
    """

    def update(
        learner: Learner,
        normaliser: Normaliser,
        rollout: Rollout,
        last_observation: jax.Array,
        key: jax.Array,
        moves_actor: jax.Array,
    ) -> tuple[Learner, dict[str, jax.Array]]:
        batch, batch_metrics = _batch(networks, config, learner.parameters, normaliser, rollout, last_observation)
        key_order, key_entropy = jax.random.split(key)
        order = minibatches(config, batch.weight.shape[0], key_order)
        keys = jax.random.split(key_entropy, order.shape[0])
        batch, order = _cut_over_devices(mesh, batch, order)

        def step(learner: Learner, inputs: tuple[jax.Array, jax.Array]) -> tuple[Learner, dict[str, jax.Array]]:
            rows, key = inputs
            minibatch = jax.tree.map(lambda x: x[rows], batch)
            gradient, metrics = jax.grad(ppo_loss, has_aux=True)(
                learner.parameters, normaliser, minibatch, key, networks, config
            )
            gradient["policy"] = jax.tree.map(lambda leaf: jnp.where(moves_actor, leaf, 0), gradient["policy"])
            return gradient_step(config, learner, gradient), metrics

        learner, metrics = jax.lax.scan(step, learner, (order, keys))
        kl = jnp.mean(metrics["kl"][-config.num_minibatches :])  # of the last epoch
        means = {name: jnp.mean(values) for name, values in metrics.items()}
        means |= batch_metrics | {"kl": kl, "learning_rate": learner.learning_rate}
        if config.learning_rate_schedule == "adaptive_kl":
            adapted = adapted_rate(config, learner.learning_rate, kl)
            learner = dataclasses.replace(learner, learning_rate=jnp.where(moves_actor, adapted, learner.learning_rate))
        return learner, means

    return update


def _cut_over_devices(mesh: Mesh | None, batch: Batch, order: jax.Array) -> tuple[Batch, jax.Array]:
    """All rows on every device, and each minibatch's numbers cut over them, where they divide evenly."""
    if mesh is None or mesh.size == 1:
        return batch, order
    whole = jax.lax.with_sharding_constraint(batch, NamedSharding(mesh, P()))
    cut = P(None, ENVS) if order.shape[1] % mesh.size == 0 else P()
    return whole, jax.lax.with_sharding_constraint(order, NamedSharding(mesh, cut))


def gradient_step(config: PPOConfig, learner: Learner, gradient: dict[str, Any]) -> Learner:
    """One step of Adam along the gradients of actor and critic, each clipped by its own global norm."""
    clip = optax.clip_by_global_norm(config.max_gradient_norm)
    clipped = {name: clip.update(part, optax.EmptyState())[0] for name, part in gradient.items()}
    direction, optimiser_state = optax.scale_by_adam().update(clipped, learner.optimiser_state)
    rates = {"policy": learner.learning_rate, "value": config.critic_learning_rate}
    changes = jax.tree.map(lambda rate, part: jax.tree.map(lambda leaf: rate * leaf, part), rates, direction)
    parameters = jax.tree.map(jnp.subtract, learner.parameters, changes)
    return Learner(parameters, optimiser_state, learner.learning_rate)


def adapted_rate(config: PPOConfig, rate: jax.Array, kl: jax.Array) -> jax.Array:
    """Slower where an update moved the policy twice as far as wanted, faster where half as far.

    Rule and factor are rsl_rl's, but once an update, not at every gradient step: the divergence adds up over the
    steps, so that the rate would run up at the start of every update and down at its end.
    """
    slower, faster = rate / 1.5, rate * 1.5
    rate = jnp.where(kl > 2 * config.target_kl, slower, jnp.where(kl < config.target_kl / 2, faster, rate))
    return jnp.clip(rate, config.min_learning_rate, config.max_learning_rate)


def _batch(
    networks: PPONetworks,
    config: PPOConfig,
    parameters: Any,
    normaliser: Any,
    rollout: Rollout,
    last_observation: jax.Array,
) -> tuple[Batch, dict[str, jax.Array]]:
    """The rollout as rows, (steps * envs, ...), with advantages normalised over its valid rows."""
    values = networks.value_network.apply(normaliser, parameters["value"], rollout.observation)
    last_value = networks.value_network.apply(normaliser, parameters["value"], {CRITIC_KEY: last_observation})
    scaled = dataclasses.replace(rollout, reward=rollout.reward * config.reward_scaling)
    advantages, returns = advantages_and_returns(
        scaled, values, last_value, rollout.final_value, config.discount, config.gae_lambda
    )
    weight = rollout.valid.astype(jnp.float32)
    mean, variance = _moments(advantages, weight)
    fields = {name: getattr(rollout, name) for name in ("observation", "raw_action", "logits", "log_probability")}
    batch = Batch(**fields, advantage=(advantages - mean) / jnp.sqrt(variance + 1e-8), returns=returns, weight=weight)
    explained = 1 - _moments(returns - values, weight)[1] / jnp.maximum(_moments(returns, weight)[1], 1e-8)
    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)
    return rows, {"explained_variance": explained, "value": _moments(values, weight)[0]}


def minibatches(config: PPOConfig, num_rows: int, key: jax.Array) -> jax.Array:
    """(epochs * minibatches, rows) int32: every epoch in another order; what does not divide evenly is left out."""
    size = num_rows // config.num_minibatches

    def order(key: jax.Array) -> jax.Array:
        rows = jax.random.permutation(key, jnp.arange(num_rows, dtype=jnp.int32))
        return rows[: size * config.num_minibatches].reshape(config.num_minibatches, size)

    return jax.vmap(order)(jax.random.split(key, config.num_epochs)).reshape(-1, size)


def _moments(rows: jax.Array, weight: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Mean and variance of the rows of weight 1."""
    count = jnp.maximum(jnp.sum(weight), 1.0)
    mean = jnp.sum(weight * rows) / count
    return mean, jnp.sum(weight * jnp.square(rows - mean)) / count
