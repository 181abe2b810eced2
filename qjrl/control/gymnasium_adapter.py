"""The residual environment for Gymnasium: all arms as one vector environment, or a single arm. Needs `qjrl[gymnasium]`.

Each holds a `State` and calls two compiled functions. The actor's observation is the observation; the critic's is
`info["privileged_state"]`. Registered as `qjrl/Residual-v0`: `gymnasium.make_vec("qjrl/Residual-v0", robot="qj_22")`.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from qjrl.control.environment import ResidualEnv
from qjrl.control.nominal_environment import nominal_environment
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, Observation, State, observation_sizes
from qjrl.xla_options import jit_of_chains

_LARGEST_SEED = 2**31


class ResidualVectorEnv(VectorEnv):
    """`num_envs` arms, stepped together.

    Arms whose episode has ended begin anew within the same step (`AutoresetMode.SAME_STEP`): the observation is the first
    of the next episode, `info["final_obs"]` the last of the one that ended, in the rows of the mask `info["_final_obs"]`.
    An arm whose simulation diverged counts as truncated where it was last sound, and `info["valid"]` is False.
    """

    def __init__(self, env: ResidualEnv, num_envs: int):
        self._env, self.num_envs, self._state = env, num_envs, None
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
        self.single_observation_space, self.single_action_space = _spaces(env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Every arm afresh, in whole episodes; without a seed, other ones than before."""
        del options
        super().reset(seed=seed)
        self._state = _begun(self._env, self.np_random, self.num_envs)
        return np.array(self._state.observation[ACTOR_KEY]), _info(self._state.observation)

    def step(self, actions: np.ndarray):
        """One control period of every arm; actions (num_envs, action size) in [-1, 1]."""
        before, self._state = _stepped(self._env, self._state, actions)
        terminated, truncated, final = _ends(self._state, before)
        ended = terminated | truncated
        info = _info(self._state.observation, self._state.metrics) | {"valid": np.array(self._state.valid)}
        if ended.any():
            info |= {"final_obs": np.where(ended[:, None], final, np.float32(0.0)), "_final_obs": ended}
        reward = np.array(self._state.reward, np.float64)
        return np.array(self._state.observation[ACTOR_KEY]), reward, terminated, truncated, info


class ResidualArmEnv(gymnasium.Env):
    """One arm; an episode that has ended waits for `reset`."""

    def __init__(self, env: ResidualEnv):
        self._env, self._state, self.metadata = env, None, {"render_modes": []}
        self.observation_space, self.action_space = _spaces(env)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """A new episode; without a seed, another one than before."""
        del options
        super().reset(seed=seed)
        self._state = _begun(self._env, self.np_random, 1)
        return np.array(self._state.observation[ACTOR_KEY][0]), _first_row(_info(self._state.observation))

    def step(self, action: np.ndarray):
        """One control period; action (action size,) in [-1, 1]."""
        before, self._state = _stepped(self._env, self._state, np.asarray(action)[None])
        terminated, truncated, last = _ends(self._state, before)
        info = _first_row(_info(self._state.final_observation, self._state.metrics))
        info |= {"valid": bool(self._state.valid[0])}
        return last[0], float(self._state.reward[0]), bool(terminated[0]), bool(truncated[0]), info


def make_vec(num_envs: int = 1, robot: str = "qj_2222", **kwargs: Any) -> ResidualVectorEnv:
    """What `gymnasium.make_vec("qjrl/Residual-v0", num_envs=..., robot=...)` makes; see `nominal_environment`."""
    return ResidualVectorEnv(nominal_environment(robot, **kwargs), num_envs)


def make(robot: str = "qj_2222", **kwargs: Any) -> ResidualArmEnv:
    """What `gymnasium.make("qjrl/Residual-v0", robot=...)` makes."""
    return ResidualArmEnv(nominal_environment(robot, **kwargs))


def _begun(env: ResidualEnv, random: np.random.Generator, count: int) -> State:
    with jax.enable_x64(False):
        return _reset(env, jax.random.split(jax.random.key(int(random.integers(_LARGEST_SEED))), count))


def _stepped(env: ResidualEnv, state: State | None, actions: np.ndarray) -> tuple[Observation, State]:
    """The observation before, and the state after."""
    if state is None:
        raise gymnasium.error.ResetNeeded("step: the environment has not been reset; call reset() first")
    with jax.enable_x64(False):
        return state.observation, _step(env, state, np.asarray(actions, np.float32))


@jit_of_chains
def _reset(env: ResidualEnv, keys: jax.Array) -> State:
    return env.reset(keys)


@jit_of_chains
def _step(env: ResidualEnv, state: State, actions: jax.Array) -> State:
    return env.step(state, actions)


def _spaces(env: ResidualEnv) -> tuple[Box, Box]:
    """Of one arm: observations (n,) and actions (m,)."""
    with jax.enable_x64(False):
        size = observation_sizes(env)[ACTOR_KEY]
    return Box(-np.inf, np.inf, (size,), np.float32), Box(-1.0, 1.0, (env.action_size,), np.float32)


def _ends(state: State, before: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Who terminated, who was truncated or diverged, and the last sound observations (n, size)."""
    valid = np.array(state.valid)
    last = np.where(valid[:, None], state.final_observation[ACTOR_KEY], before[ACTOR_KEY])
    return np.array(state.terminated), np.array(state.truncated) | ~valid, last


def _info(observation: Observation, metrics: Mapping[str, Any] | None = None) -> dict[str, np.ndarray]:
    return {
        name: np.array(value) for name, value in ({CRITIC_KEY: observation[CRITIC_KEY]} | dict(metrics or {})).items()
    }


def _first_row(info: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: value[0] for name, value in info.items()}
