"""A start for PPO: the actor fitted to the actions that only the simulation knows to be best, on what it meets itself.

Rounds of acting and fitting (Ross et al. 2011, "A reduction of imitation learning ..."): random actions first, held for
a while each, so that the actor learns what its own actions do not change; then the actor fitted so far, with a little of
the same noise. Every round goes on from the actor of the last one with new rows alone: an episode is one draw of target,
arm and noise, an actor that sees few of them many times learns them by heart, and fresh ones cost little. The advice is
privileged (Chen et al. 2019, "Learning by cheating"), the actor sees its own observation alone, so that it learns the
best guess that its sensors allow.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from qjrl.config import Range
from qjrl.keys import key_for, seed_for
from qjrl.learning import processes
from qjrl.learning.divergence import Evidence
from qjrl.learning.ppo.environment import ACTOR_KEY, Observation, VectorEnv, advice_of, num_copies
from qjrl.learning.ppo.normaliser import Normaliser
from qjrl.learning.ppo.policy import Policy, deterministic_action, moderated
from qjrl.learning.ppo.rollout import finite_rows

# Steps for which a random action is held.
_HELD = 25


@dataclasses.dataclass(frozen=True)
class ImitationConfig:
    """Rounds of acting and fitting."""

    rounds: Annotated[int, Range(0, 1000)] = 0
    """Every one is an iteration of the training; 0: PPO starts from the untrained actor."""
    steps: Annotated[int, Range(1, 1_000_000)] = 1000
    """Of every copy in a round."""
    every: Annotated[int, Range(1, 1000)] = 5
    """Every so-manieth step is kept: neighbours say the same."""
    exploration: Annotated[float, Range(0, 1)] = 0.1
    """Standard deviation of the random actions of the first round; a tenth of it in the later ones."""
    epochs: Annotated[int, Range(1, 1000)] = 4
    """Passes over the rows of a round."""
    batch_size: Annotated[int, Range(1)] = 512
    """Rows of a gradient step."""
    learning_rate: Annotated[float, Range(above=0, high=1)] = 2e-3
    """Of Adam, in the first round; it falls to 0 along a cosine until the end of the last one."""
    share: Annotated[float, Range(above=0, high=1)] = 1.0
    """Of the fitted action that the actor is left with after the last round: a fit on few episodes says too much, most of all
    about what it has not seen."""


@dataclasses.dataclass(frozen=True)
class Imitated:
    """What the next round goes on from, or PPO."""

    policy: Policy
    """The actor; before the first round one whose deterministic action is zero."""
    normaliser: Normaliser
    """Statistics of all rows so far."""
    observation: Observation
    """What the next action answers to."""
    loss: float = math.nan
    """Mean distance from the advice in the last epoch; actions are in [-1, 1]."""
    num_invalid: int = 0
    """Steps of the round in which copies of this process diverged; what was seen before them is not imitated."""
    diverged: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """What is known of the first of them."""


def imitate(
    environment: VectorEnv,
    config: ImitationConfig,
    number: int,
    before: Imitated,
    take_in: Callable[..., Normaliser],
    seed: int,
    advance: Callable[[int], None],
) -> Imitated:
    """Round `number`, from 0: acts and fits; the environment is stepped on from where it is. Of several processes each acts
    with its own copies, and all fit the same to the rows of all.

    Args:
        before: what the round before returned.
        take_in: `normaliser.update_normaliser`, compiled, for the rows of all processes.
        advance: called with the number of environment steps made.
    """
    random = np.random.default_rng([seed_for(seed, "dagger"), number])
    deviation = config.exploration * (1.0 if number == 0 else 0.1)
    acted = _act(environment, config, before, take_in, deviation, random, advance)
    statistics: Any = acted.normaliser
    mean, std = statistics.mean[ACTOR_KEY], statistics.std[ACTOR_KEY]
    policy = dataclasses.replace(before.policy, mean=np.asarray(mean), std=np.asarray(std))
    rows = _sound_rows_of_all(acted.kept)
    policy, loss = _fit(policy, config, number, rows, jax.random.fold_in(key_for(seed, "dagger"), number))
    if number == config.rounds - 1:
        policy = moderated(policy, config.share)
    return Imitated(policy, acted.normaliser, acted.observation, loss, acted.num_invalid, acted.evidence.arrays())


@dataclasses.dataclass
class _Acted:
    """What was seen while acting."""

    normaliser: Normaliser
    observation: Observation
    kept: list[tuple[np.ndarray, ...]]
    """Of every step that is kept, for all copies: observations, advice, which are finite and valid."""
    num_invalid: int
    evidence: Evidence


def _act(environment, config: ImitationConfig, before: Imitated, take_in, deviation: float, random, advance) -> _Acted:
    act = jax.jit(deterministic_action)
    copies = num_copies(environment)
    own, noise = processes.own_rows(copies), np.zeros(0)
    acted = _Acted(before.normaliser, before.observation, [], 0, Evidence())
    for step in range(config.steps):
        if step % _HELD == 0:
            noise = random.normal(0.0, deviation, (copies, environment.action_size)).astype(np.float32)[own]
        observation, is_sound = finite_rows(acted.observation)
        actions = np.clip(np.asarray(act(before.policy, observation[ACTOR_KEY])) + noise, -1.0, 1.0)
        transition = environment.step(actions)
        is_sound &= np.asarray(transition.valid)
        if step % config.every == 0:
            acted.normaliser = take_in(acted.normaliser, _with_time(observation), is_sound[None])
            advice = np.asarray(advice_of(observation, environment.action_size))
            acted.kept.append((observation[ACTOR_KEY], advice, is_sound))
        acted.num_invalid += int(np.sum(~is_sound))
        acted.evidence.add(transition.diverged, step)
        acted.observation = transition.observation
        advance(copies)
    return acted


def _sound_rows_of_all(kept: list[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, np.ndarray]:
    """(observations, advice) of the copies of all processes, step by step, of the rows that are sound."""
    by_copy = processes.gathered(tuple(np.stack(column, axis=1) for column in zip(*kept, strict=True)))
    observations, advice, is_sound = (np.swapaxes(column, 0, 1) for column in by_copy)
    return observations[is_sound], advice[is_sound]


def _with_time(observation: Observation) -> dict[str, Any]:
    return {name: np.asarray(rows)[None] for name, rows in observation.items()}


def _fit(
    policy: Policy, config: ImitationConfig, number: int, rows: tuple[np.ndarray, ...], key: jax.Array
) -> tuple[Policy, float]:
    """The policy's layers fitted on to (observations, advice), and the mean distance in the last epoch."""
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
def _epoch(carry, policy: Policy, rows, batches: jax.Array, rates: jax.Array):
    """Layers and state of Adam after a step for each row of `batches` (steps, batch), and the mean loss."""

    def step(carry, inputs):
        (layers, state), (chosen, rate) = carry, inputs
        loss, gradient = jax.value_and_grad(_distance)(layers, policy, rows[0][chosen], rows[1][chosen])
        direction, state = optax.scale_by_adam().update(gradient, state)
        return (jax.tree.map(lambda old, change: old - rate * change, layers, direction), state), loss

    carry, losses = jax.lax.scan(step, carry, (batches, rates))
    return carry, jnp.mean(losses)


def _distance(layers: Any, policy: Policy, observation: jax.Array, advice: jax.Array) -> jax.Array:
    """Mean distance, not its square: the rows that nobody could foretell weigh no more than the others."""
    gap = deterministic_action(dataclasses.replace(policy, layers=layers), observation) - advice
    return jnp.mean(jnp.sqrt(jnp.sum(gap**2, axis=-1) + 1e-6))
