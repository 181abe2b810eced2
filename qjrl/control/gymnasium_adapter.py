"""The residual environment for Gymnasium: all arms as one vector environment, or a single arm. Needs `qjrl[gymnasium]`.

The actor's observation is the observation; the critic's is `info["privileged_state"]`.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from qjrl.control.environment import ResidualEnvironment
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, Observation, Transition

_LARGEST_SEED = 2**31


class ResidualVectorEnv(VectorEnv):
    """All arms of a `ResidualEnvironment`, stepped together.

    Arms whose episode has ended begin anew within the same step (`AutoresetMode.SAME_STEP`): the observation is the first
    of the next episode, `info["final_obs"]` the last of the one that ended, in the rows of the mask `info["_final_obs"]`.
    An arm whose simulation diverged counts as truncated where it was last sound, and `info["valid"]` is False.
    """

    def __init__(self, environment: ResidualEnvironment):
        self._environment, self.num_envs = environment, environment.num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
        self.single_observation_space, self.single_action_space = _spaces(environment)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._observation = np.zeros(self.observation_space.shape or (), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Every arm afresh, in whole episodes; without a seed, other ones than before."""
        del options
        super().reset(seed=seed)
        first = self._environment.reset(int(self.np_random.integers(_LARGEST_SEED)), is_spread=False)
        self._observation = np.array(first[ACTOR_KEY])
        return self._observation.copy(), _info(first)

    def step(self, actions: np.ndarray):
        """One control period of every arm; actions (num_envs, action size) in [-1, 1]."""
        before, transition = self._observation, self._environment.step(actions)
        self._observation = np.array(transition.observation[ACTOR_KEY])
        terminated, truncated, final = _ends(transition, before)
        ended = terminated | truncated
        info = _info(transition.observation, transition.metrics) | {"valid": np.array(transition.valid)}
        if ended.any():
            info |= {"final_obs": np.where(ended[:, None], final, np.float32(0.0)), "_final_obs": ended}
        return self._observation.copy(), np.array(transition.reward, np.float64), terminated, truncated, info


class ResidualEnv(gymnasium.Env):
    """One arm; an episode that has ended waits for `reset`."""

    def __init__(self, environment: ResidualEnvironment):
        if environment.num_envs != 1:
            raise ValueError(f"environment: got {environment.num_envs} arms, allowed: 1")
        self._environment, self.metadata = environment, {"render_modes": []}
        self.observation_space, self.action_space = _spaces(environment)
        self._observation = np.zeros((1, *(self.observation_space.shape or ())), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """A new episode; without a seed, another one than before."""
        del options
        super().reset(seed=seed)
        first = self._environment.reset(int(self.np_random.integers(_LARGEST_SEED)), is_spread=False)
        self._observation = np.array(first[ACTOR_KEY])
        return self._observation[0].copy(), _first_row(_info(first))

    def step(self, action: np.ndarray):
        """One control period; action (action size,) in [-1, 1]."""
        before, transition = self._observation, self._environment.step(np.asarray(action)[None])
        terminated, truncated, self._observation = _ends(transition, before)
        info = _first_row(_info(transition.final_observation, transition.metrics)) | {
            "valid": bool(transition.valid[0])
        }
        return self._observation[0].copy(), float(transition.reward[0]), bool(terminated[0]), bool(truncated[0]), info


def _spaces(environment: ResidualEnvironment) -> tuple[Box, Box]:
    """Of one arm: observations (n,) and actions (m,)."""
    size = environment.observation_sizes[ACTOR_KEY]
    return Box(-np.inf, np.inf, (size,), np.float32), Box(-1.0, 1.0, (environment.action_size,), np.float32)


def _ends(transition: Transition, before: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Who terminated, who was truncated or diverged, and the last sound observations (n, size)."""
    valid = np.array(transition.valid)
    last = np.where(valid[:, None], transition.final_observation[ACTOR_KEY], before)
    return np.array(transition.terminated), np.array(transition.truncated) | ~valid, last


def _info(observation: Observation, metrics: Mapping[str, Any] | None = None) -> dict[str, np.ndarray]:
    return {
        name: np.array(value) for name, value in ({CRITIC_KEY: observation[CRITIC_KEY]} | dict(metrics or {})).items()
    }


def _first_row(info: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: value[0] for name, value in info.items()}
