"""Running the deterministic policy."""

from collections.abc import Iterator

import jax
import numpy as np

from qjrl.learning.ppo.environment import ACTOR_KEY, Transition, VectorEnv
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.policy import Policy, deterministic_action


def roll_out(environment: VectorEnv, policy: Policy, num_steps: int) -> Iterator[Transition]:
    """Resets the environment, then yields `num_steps` transitions of the deterministic policy."""
    act = jax.jit(deterministic_action)
    observation = environment.reset()
    for _ in range(num_steps):
        transition = environment.step(np.asarray(act(policy, observation[ACTOR_KEY])))
        yield transition
        observation = transition.observation


def evaluate(environment: VectorEnv, policy: Policy, num_steps: int) -> dict[str, float | None]:
    """Mean reward, returns and environment metrics of the deterministic policy.

    The environment is left as it was, so that the one being trained on can be used.
    """
    before = environment.get_state()
    episodes = EpisodeLog(environment.num_envs)
    rewards, num_invalid = [], 0
    for transition in roll_out(environment, policy, num_steps):
        episodes.add(transition)
        valid = np.asarray(transition.valid, bool)
        rewards.append(np.asarray(transition.reward)[valid])
        num_invalid += int((~valid).sum())
    environment.set_state(before)
    return {"reward": float(np.mean(np.concatenate(rewards))), "invalid": num_invalid} | episodes.summary()
