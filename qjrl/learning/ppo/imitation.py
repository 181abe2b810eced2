"""A start for PPO: the actor fitted to the actions that only the simulation knows to be best, on what it meets itself.

Rounds of acting and fitting (Ross et al. 2011, "A reduction of imitation learning ..."): random actions first, held for
a while each, so that the actor learns what its own actions do not change; then the actor fitted so far, with a little of
the same noise. All rounds' rows are kept and fitted together. The advice is privileged (Chen et al. 2019, "Learning
by cheating"), the actor sees its own observation alone, so that it learns the best guess that its sensors allow.
"""

import dataclasses
import functools
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from qjrl import progress
from qjrl.config import Range
from qjrl.learning.ppo.environment import ACTOR_KEY, Observation, VectorEnv, advice_of
from qjrl.learning.ppo.normaliser import Normaliser, initial_normaliser, update_normaliser
from qjrl.learning.ppo.policy import Policy, deterministic_action
from qjrl.learning.ppo.rollout import finite_rows

# Steps for which a random action is held.
_HELD = 25


@dataclasses.dataclass(frozen=True)
class ImitationConfig:
    """Rounds of acting and fitting."""

    rounds: Annotated[int, Range(0, 100)] = 0
    """0: PPO starts from the untrained actor."""
    steps: Annotated[int, Range(1, 1_000_000)] = 1000
    """Of every copy in a round."""
    every: Annotated[int, Range(1, 1000)] = 5
    """Every so-manieth step is kept: neighbours say the same."""
    exploration: Annotated[float, Range(0, 1)] = 0.1
    """Standard deviation of the random actions of the first round; a tenth of it in the later ones."""
    epochs: Annotated[int, Range(1, 1000)] = 20
    """Passes over all rows kept, after every round."""
    batch_size: Annotated[int, Range(1)] = 512
    """Rows of a gradient step."""
    learning_rate: Annotated[float, Range(above=0, high=1)] = 2e-3
    """Of Adam, at the start of every fit; it falls to 0 along a cosine."""


@dataclasses.dataclass(frozen=True)
class Imitated:
    """What PPO starts from."""

    layers: Any
    """Of the actor, as in `Policy.layers`."""
    normaliser: Normaliser
    observation: Observation
    """To go on from."""
    env_steps: int
    loss: float
    """Mean distance from the advice in the last epoch; actions are in [-1, 1]."""


def imitate(
    environment: VectorEnv, config: ImitationConfig, untrained: Policy, observation: Observation, seed: int
) -> Imitated:
    """Acts and fits; the environment is stepped on from where it is.

    Args:
        untrained: an actor whose deterministic action is zero.
        observation: what the first action answers to.
    """
    normaliser, policy, kept, loss = initial_normaliser(environment.observation_sizes), untrained, [], float("nan")
    take_in, act = jax.jit(update_normaliser), jax.jit(deterministic_action)
    total = config.rounds * config.steps * environment.num_envs
    shape = (environment.num_envs, environment.action_size)
    with progress.track(total, "imitation") as advance:
        for number in range(config.rounds):
            noise, generator = np.zeros(shape, np.float32), np.random.default_rng([seed, number])
            for step in range(config.steps):
                if step % _HELD == 0:
                    deviation = config.exploration * (1.0 if number == 0 else 0.1)
                    noise = generator.normal(0.0, deviation, shape).astype(np.float32)
                observation, is_finite = finite_rows(observation)
                if step % config.every == 0:
                    normaliser = take_in(normaliser, _with_time(observation), is_finite[None])
                    advice = np.asarray(advice_of(observation, environment.action_size))
                    kept.append((observation[ACTOR_KEY][is_finite], advice[is_finite]))
                actions = np.clip(np.asarray(act(policy, observation[ACTOR_KEY])) + noise, -1.0, 1.0)
                observation = environment.step(actions).observation
                advance(environment.num_envs)
            rows = tuple(np.concatenate(columns) for columns in zip(*kept, strict=True))
            statistics = dataclasses.replace(policy, mean=_of_actor(normaliser.mean), std=_of_actor(normaliser.std))
            key = jax.random.fold_in(jax.random.key(seed), number)
            policy, loss = _fit(dataclasses.replace(statistics, layers=untrained.layers), config, rows, key)
    return Imitated(policy.layers, normaliser, observation, total, loss)


def _of_actor(statistics: Any) -> np.ndarray:
    return np.asarray(statistics[ACTOR_KEY])


def _with_time(observation: Observation) -> dict[str, Any]:
    return {name: np.asarray(rows)[None] for name, rows in observation.items()}


def _fit(policy: Policy, config: ImitationConfig, rows: tuple[np.ndarray, ...], key: jax.Array) -> tuple[Policy, float]:
    """The policy's layers fitted to (observations, advice), and the mean distance in the last epoch."""
    batch_size = min(config.batch_size, len(rows[0]))
    per_epoch = len(rows[0]) // batch_size
    optimiser = optax.adam(optax.cosine_decay_schedule(config.learning_rate, config.epochs * per_epoch))
    layers = jax.tree.map(jnp.asarray, policy.layers)
    carry, on_device, loss = (layers, optimiser.init(layers)), jax.tree.map(jnp.asarray, rows), jnp.nan
    epoch = jax.jit(functools.partial(_epoch, optimiser, per_epoch, batch_size), donate_argnums=0)
    for number in range(config.epochs):
        carry, loss = epoch(carry, policy, on_device, jax.random.fold_in(key, number))
    return dataclasses.replace(policy, layers=jax.tree.map(np.asarray, carry[0])), float(loss)


def _epoch(optimiser, per_epoch: int, batch_size: int, carry, policy: Policy, rows, key: jax.Array):
    order = jax.random.permutation(key, jnp.arange(len(rows[0]), dtype=jnp.int32))

    def step(carry, chosen):
        layers, state = carry
        loss, gradient = jax.value_and_grad(_distance)(layers, policy, rows[0][chosen], rows[1][chosen])
        change, state = optimiser.update(gradient, state)
        return (optax.apply_updates(layers, change), state), loss

    carry, losses = jax.lax.scan(step, carry, order[: per_epoch * batch_size].reshape(per_epoch, batch_size))
    return carry, jnp.mean(losses)


def _distance(layers: Any, policy: Policy, observation: jax.Array, advice: jax.Array) -> jax.Array:
    """Mean distance, not its square: the rows that nobody could foretell weigh no more than the others."""
    gap = deterministic_action(dataclasses.replace(policy, layers=layers), observation) - advice
    return jnp.mean(jnp.sqrt(jnp.sum(gap**2, axis=-1) + 1e-6))
