"""DAgger: a start for PPO, the actor fitted to the expert's actions on what it meets itself.

Rounds of acting and fitting (Ross et al. 2011, "A reduction of imitation learning and structured prediction to no-regret
online learning"): random actions first, held for a while each, so that the actor learns what its own actions do not
change; then the actor fitted so far, with a little of the same noise. Every round goes on from the actor of the last one
with new rows alone: an episode is one draw of target, arm and noise. The expert is privileged (Chen et al. 2019,
"Learning by cheating"); the actor sees its own observation alone, so that it learns the best guess that its sensors allow.
"""

import dataclasses
import functools
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from qjrl.config import Range, configuration
from qjrl.learning.ppo.policy import Policy, deterministic_action


@configuration
class DaggerConfig:
    """Rounds of acting and fitting; all values ours."""

    rounds: Annotated[int, Range(0, 1000)] = 4
    """Each is an iteration of the training; 0: PPO starts from the untrained actor."""
    steps: Annotated[int, Range(1, 1_000_000)] = 500
    """Steps of every env in a round, rounded up to whole rollouts; a random action is held for one of them."""
    every: Annotated[int, Range(1, 1000)] = 5
    """Interval between stored steps; neighbours hardly differ."""
    exploration: Annotated[float, Range(0, 1)] = 0.1
    """Standard deviation of the random actions of the first round; a tenth of it in the later ones."""
    epochs: Annotated[int, Range(1, 1000)] = 8
    """Passes over the rows of a round."""
    batch_size: Annotated[int, Range(1)] = 512
    """Rows of a gradient step."""
    learning_rate: Annotated[float, Range(above=0, high=1)] = 2e-3
    """Of Adam, in the first round; it falls to 0 along a cosine until the end of the last one."""
    share: Annotated[float, Range(above=0, high=1)] = 0.6
    """Of the fitted action that the actor is left with after the last round: a fit on few episodes says too much, most of all
    about what it has not seen. With all of it the policy was worse than its base on arms of another kind."""


def deviation(config: DaggerConfig, number: int) -> float:
    """Standard deviation of the random actions of a round, numbered from 0."""
    return config.exploration * (1.0 if number == 0 else 0.1)


def fit_round(
    policy: Policy, config: DaggerConfig, number: int, rows: tuple[np.ndarray, np.ndarray], key: jax.Array
) -> tuple[Policy, float]:
    """The policy fitted on to (observations, expert's actions) of a round, and the mean distance in the last epoch."""
    batch_size = min(config.batch_size, len(rows[0]))
    per_epoch = len(rows[0]) // batch_size
    per_round = config.epochs * per_epoch
    schedule = optax.cosine_decay_schedule(config.learning_rate, config.rounds * per_round)
    layers, on_device = jax.tree.map(jnp.array, (policy.layers, rows))
    loss = jnp.nan
    carry = layers, optax.scale_by_adam().init(layers)
    for passed in range(config.epochs):
        order = jax.random.permutation(jax.random.fold_in(key, passed), jnp.arange(len(rows[0]), dtype=jnp.int32))
        batches = order[: per_epoch * batch_size].reshape(per_epoch, batch_size)
        rates = schedule(number * per_round + passed * per_epoch + jnp.arange(per_epoch))
        carry, loss = _epoch(carry, policy, on_device, batches, rates)
    return dataclasses.replace(policy, layers=jax.tree.map(np.asarray, carry[0])), float(loss)


@functools.partial(jax.jit, donate_argnums=0)
def _epoch(carry: Any, policy: Policy, rows: Any, batches: jax.Array, rates: jax.Array):
    """Layers and state of Adam after a step for each row of `batches` (steps, batch), and the mean loss."""

    def step(carry, inputs):
        (layers, state), (chosen, rate) = carry, inputs
        loss, gradient = jax.value_and_grad(_distance)(layers, policy, rows[0][chosen], rows[1][chosen])
        direction, state = optax.scale_by_adam().update(gradient, state)
        return (jax.tree.map(lambda old, change: old - rate * change, layers, direction), state), loss

    carry, losses = jax.lax.scan(step, carry, (batches, rates))
    return carry, jnp.mean(losses)


def _distance(layers: Any, policy: Policy, observation: jax.Array, expert: jax.Array) -> jax.Array:
    """Mean distance, not its square: the rows that nobody could foretell weigh no more than the others."""
    gap = deterministic_action(dataclasses.replace(policy, layers=layers), observation) - expert
    return jnp.mean(jnp.sqrt(jnp.sum(gap**2, axis=-1) + 1e-6))
