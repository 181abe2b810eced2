"""Toy environments, each of which only works if one mechanism of PPO does.

The idea is Andy Jones's (andyljones.com/posts/rl-debugging.html): value loss; backpropagation to the observation;
discount; policy gradient; policy gradient by observation.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from qjrl.learning.ppo.environment import Transition

NUM_ENVS = 64

Reward = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(observation (n,), action (n,)) -> (n,)."""


def a_sign(rng: np.random.Generator, time: int) -> np.ndarray:
    """-1 or 1."""
    del time
    return rng.choice(np.array([-1, 1], np.float32), NUM_ENVS)


def nothing(rng: np.random.Generator, time: int) -> np.ndarray:
    """Always 0."""
    del rng, time
    return np.zeros(NUM_ENVS, np.float32)


def the_time(rng: np.random.Generator, time: int) -> np.ndarray:
    """Steps since the start of the episode."""
    del rng
    return np.full(NUM_ENVS, time, np.float32)


class ProbeEnvironment:
    """Episodes of `length` steps; every observation is drawn afresh. Its random state is a counter."""

    num_envs = NUM_ENVS
    action_size = 1

    def __init__(self, observe: Callable[..., np.ndarray], reward: Reward, length: int = 1, truncates: bool = False):
        self.observation_sizes = {"state": 1, "privileged_state": 1}
        self.gives_advice = False
        self.observe, self.reward, self.length, self.truncates = observe, reward, length, truncates
        self.count = self.time = 0
        self.seen = np.zeros(NUM_ENVS, np.float32)

    def reset(self) -> dict[str, np.ndarray]:
        self.time = 0
        return self._observation()

    def step(self, actions: np.ndarray) -> Transition:
        reward = self.reward(self.seen, np.asarray(actions)[:, 0])
        self.time += 1
        final = self._observation()
        ends = np.full(NUM_ENVS, self.time == self.length)
        observation = self.reset() if ends[0] else final
        never = np.zeros(NUM_ENVS, bool)
        terminated, truncated = (never, ends) if self.truncates else (ends, never)
        valid = np.ones(NUM_ENVS, bool)
        return Transition(observation, reward, terminated, truncated, final, valid, {"size": np.abs(reward)})

    def get_state(self) -> dict[str, np.ndarray]:
        return {"counters": np.array([self.count, self.time]), "seen": self.seen, "none": np.zeros((0, 2))}

    def set_state(self, state: Mapping[str, Any]) -> None:
        self.count, self.time = (int(counter) for counter in state["counters"])
        self.seen = state["seen"]

    def _observation(self) -> dict[str, np.ndarray]:
        self.count += 1
        self.seen = self.observe(np.random.default_rng(self.count), self.time)
        return {"state": self.seen[:, None], "privileged_state": self.seen[:, None]}
