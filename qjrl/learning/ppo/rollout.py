"""Collecting a rollout: a scan of acting and stepping, in one program."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.learning.ppo.brax_parts import PPONetworks
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, Env, Observation, State
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.some_rows import for_some_rows


@struct.dataclass
class Action:
    """What the policy decided, (envs, ...) float32."""

    action: Any
    """What the env is given, in [-1, 1]."""
    raw_action: Any
    """Before the tanh."""
    logits: Any
    """Mean and scale parameter: (envs, 2 action_size)."""
    log_probability: Any


@struct.dataclass
class Rollout:
    """A block of experience, (steps, envs, ...). Rows that are not `valid` are finite too, and count nowhere."""

    observation: Any
    action: Any
    raw_action: Any
    logits: Any
    log_probability: Any
    reward: Any
    terminated: Any
    truncated: Any
    valid: Any
    final_value: Any
    """The critic's value of the final observation where the time limit cut an episode off, else 0."""


@struct.dataclass
class Collected:
    """A rollout, and where it ended."""

    rollout: Rollout
    state: State
    """To go on from."""
    last_observation: Any
    """(envs, m): the critic's, after the last step, finite."""
    episodes: EpisodeLog


Act = Callable[[Any, Any], Action]
"""Actor observations (envs, n) and the step's input -> actions."""
Value = Callable[[Any], jax.Array]
"""Critic observations (k, m) -> values (k,)."""


def collect(env: Env, act: Act, value: Value, state: State, episodes: EpisodeLog, inputs: Any) -> Collected:
    """Steps `env` from `state` as often as `inputs` has rows.

    Args:
        act: gets a row of `inputs` at every step, its exploration noise.
        value: of the final observations of episodes that the time limit cuts off.
    """

    def step(carry: tuple, row: Any) -> tuple[tuple, Rollout]:
        state, observation, is_finite, episodes = carry
        action = act(observation[ACTOR_KEY], row)
        following = env.step(state, action.action)
        after, is_finite_after = finite_rows(following.observation)
        ended = following.terminated | following.truncated
        truncated = following.truncated & ~following.terminated
        final, is_finite_end = finite_rows({CRITIC_KEY: following.final_observation[CRITIC_KEY]})
        valid = following.valid & jnp.isfinite(following.reward) & is_finite
        valid &= (is_finite_after | ended) & (is_finite_end | ~truncated)
        zeros = jnp.zeros_like(following.reward)
        outcome = Rollout(
            observation=observation,
            action=action.action,
            raw_action=action.raw_action,
            logits=action.logits,
            log_probability=action.log_probability,
            reward=jnp.where(valid, following.reward, 0.0),
            terminated=following.terminated,
            truncated=truncated,
            valid=valid,
            final_value=for_some_rows(truncated, value, final[CRITIC_KEY], zeros),
        )
        return (following, after, is_finite_after, episodes.after(following)), outcome

    first, is_finite = finite_rows(state.observation)
    (state, last, _, episodes), rollout = jax.lax.scan(step, (state, first, is_finite, episodes), inputs)
    return Collected(rollout, state, last[CRITIC_KEY], episodes)


def acting(networks: PPONetworks, parameters: Any, normaliser: Any, is_deterministic: jax.Array) -> Act:
    """The policy; a step's input is noise (envs, action size).

    PPO's exploration is standard normal noise before the tanh. Where the policy is deterministic the noise is added to its
    action: DAgger's.
    """
    distribution: Any = networks.parametric_action_distribution

    def act(observation: Any, noise: Any) -> Action:
        logits = networks.policy_network.apply(normaliser, parameters, {ACTOR_KEY: observation})
        normal = distribution.create_dist(logits)
        raw_action = normal.loc + normal.scale * noise
        around = jnp.clip(distribution.postprocess(normal.loc) + noise, -1.0, 1.0)
        action = jnp.where(is_deterministic, around, distribution.postprocess(raw_action))
        return Action(action, raw_action, logits, distribution.log_prob(logits, raw_action))

    return act


def finite_rows(observation: Observation) -> tuple[dict[str, Any], jax.Array]:
    """The observation with zeros in the rows that are not finite, and which rows are, (envs,) bool.

    The zeros only keep the arithmetic alive: these rows are counted, and weigh nothing in any update.
    """
    # A sum is finite if its terms are, unless it overflows, which is as bad.
    sums = [jnp.sum(rows, axis=1) for rows in observation.values()]
    is_finite = jnp.isfinite(jnp.stack(sums)).all(axis=0)
    return {name: jnp.where(is_finite[:, None], rows, 0.0) for name, rows in observation.items()}, is_finite
