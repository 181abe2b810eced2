"""Collecting a rollout: the host steps the environment, a compiled policy acts."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.learning import processes
from qjrl.learning.divergence import Evidence
from qjrl.learning.ppo.brax_parts import PPONetworks
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, Observation, Transition, VectorEnv
from qjrl.learning.ppo.episodes import EpisodeLog


@struct.dataclass
class Action:
    """What the policy decided, (envs, ...) float32."""

    action: Any
    """In [-1, 1]."""
    raw_action: Any
    """Before the tanh."""
    logits: Any
    """Mean and scale parameter: (envs, 2 action_size)."""
    log_probability: Any


@struct.dataclass
class Rollout:
    """A block of experience, (steps, envs, ...). Rows that are not `valid` are finite too, and count nowhere."""

    observation: Any
    """{"state", "privileged_state"}."""
    raw_action: Any
    logits: Any
    log_probability: Any
    reward: Any
    terminated: Any
    truncated: Any
    valid: Any
    last_observation: Any
    """(envs, m): the critic's, after the last step."""


@dataclasses.dataclass(frozen=True)
class Collected:
    """A rollout, and what stays on the host."""

    rollout: Rollout
    observation: Observation
    """To go on from."""
    final_rows: np.ndarray
    """(k, m): the critic's observations at which an episode was cut off by the time limit."""
    final_places: tuple[np.ndarray, np.ndarray]
    """Step and environment of each of them."""
    environment_seconds: float
    diverged: dict[str, np.ndarray]
    """`Transition.diverged` of the first copies that diverged, and the step of the rollout; empty if nothing is known."""


def make_act(networks: PPONetworks) -> Callable[[Any, Any, Any, jax.Array, Any], Action]:
    """The compiled exploring policy: (parameters, normaliser, actor observation, key, step) -> Action."""
    distribution: Any = networks.parametric_action_distribution

    def act(parameters: Any, normaliser: Any, observation: Any, key: jax.Array, step: Any) -> Action:
        logits = networks.policy_network.apply(normaliser, parameters, {ACTOR_KEY: observation})
        normal = distribution.create_dist(logits)
        # By hand, because brax's own sampling is float64 under x64; by the row among those of all processes.
        shape = (normal.loc.shape[0] * jax.process_count(), *normal.loc.shape[1:])
        noise = jax.random.normal(jax.random.fold_in(key, step), shape, jnp.float32)[processes.own_rows(shape[0])]
        raw_action = normal.loc + normal.scale * noise
        log_probability = distribution.log_prob(logits, raw_action)
        return Action(distribution.postprocess(raw_action), raw_action, logits, log_probability)

    return jax.jit(act)


def collect(
    environment: VectorEnv,
    act: Callable[[Any, int], Action],
    observation: Observation,
    num_steps: int,
    episodes: EpisodeLog,
) -> Collected:
    """Steps the environment `num_steps` times from `observation`.

    Args:
        act: actor observation (envs, n) and number of the step -> Action.
        episodes: is told of every transition.
    """
    rollout = _empty(environment, num_steps)
    finite = np.ones((num_steps + 1, environment.num_envs), bool)
    final_rows, evidence, seconds = [], Evidence(), 0.0
    for step in range(num_steps):
        observation, finite[step] = finite_rows(observation)
        action = act(observation[ACTOR_KEY], step)
        command = np.asarray(action.action)  # waits for the device
        _write_decision(rollout, step, observation, action)
        start = time.perf_counter()
        transition = environment.step(command)
        seconds += time.perf_counter() - start
        _write_outcome(rollout, step, transition)
        final_rows.append(_cut_off(rollout, step, transition))
        evidence.add(transition.diverged, step)
        episodes.add(transition)
        observation = transition.observation
    observation, finite[num_steps] = finite_rows(observation)
    rollout.last_observation[:] = observation[CRITIC_KEY]
    rollout.valid[:] &= finite[:-1] & (finite[1:] | rollout.terminated | rollout.truncated)
    rollout.reward[~rollout.valid] = 0
    places = np.nonzero(rollout.truncated)
    rows = np.concatenate(final_rows)
    return Collected(rollout, observation, rows, (places[0], places[1]), seconds, evidence.arrays())


def finite_rows(observation: Observation) -> tuple[Observation, np.ndarray]:
    """The observation with zeros in the rows that are not finite, and which rows are, (envs,) bool.

    The zeros only keep the arithmetic alive: these rows are counted, and weigh nothing in any update.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        # A sum is finite if its terms are, unless it overflows, which is as bad.
        sums = [np.asarray(rows).sum(axis=1) for rows in observation.values()]
    is_finite = np.logical_and.reduce([np.isfinite(total) for total in sums])
    if is_finite.all():
        return observation, is_finite
    return {name: np.where(is_finite[:, None], rows, np.float32(0)) for name, rows in observation.items()}, is_finite


def _empty(environment: VectorEnv, num_steps: int) -> Rollout:
    """Room for a rollout: copying into it step by step leaves the environment free to reuse its arrays."""
    num_envs, sizes, actions = environment.num_envs, environment.observation_sizes, environment.action_size

    def room(*shape: int, dtype: Any = np.float32) -> np.ndarray:
        return np.empty((num_steps, num_envs, *shape), dtype)

    return Rollout(
        observation={name: room(size) for name, size in sizes.items()},
        raw_action=room(actions),
        logits=room(2 * actions),
        log_probability=room(),
        reward=room(),
        terminated=room(dtype=bool),
        truncated=room(dtype=bool),
        valid=room(dtype=bool),
        last_observation=np.empty((num_envs, sizes[CRITIC_KEY]), np.float32),
    )


def _write_decision(rollout: Rollout, step: int, observation: Observation, action: Action) -> None:
    for name, rows in rollout.observation.items():
        rows[step] = observation[name]
    rollout.raw_action[step] = action.raw_action
    rollout.logits[step] = action.logits
    rollout.log_probability[step] = action.log_probability


def _write_outcome(rollout: Rollout, step: int, transition: Transition) -> None:
    rollout.reward[step] = transition.reward
    rollout.terminated[step] = transition.terminated
    rollout.truncated[step] = np.asarray(transition.truncated) & ~rollout.terminated[step]
    rollout.valid[step] = np.asarray(transition.valid) & np.isfinite(rollout.reward[step])


def _cut_off(rollout: Rollout, step: int, transition: Transition) -> np.ndarray:
    """(k, m): the critic's final observations of the episodes that this step truncated."""
    truncated = rollout.truncated[step]
    if not truncated.any():
        return np.empty((0, rollout.last_observation.shape[1]), np.float32)
    rows = np.asarray(transition.final_observation[CRITIC_KEY], np.float32)[truncated]
    clean, is_finite = finite_rows({CRITIC_KEY: rows})
    rollout.valid[step, truncated] &= is_finite
    return clean[CRITIC_KEY]
