"""The residual environment as brax's `Env` of one arm, so that brax's wrappers and trainers' parts run on it.

One arm is a batch of one; `jax.vmap` of it is a batch again, so there is no second implementation. The time limit is that
of brax's `EpisodeWrapper`, which alone knows how to say that an episode was cut off: give it `env.episode_length`. `done`
is the arm's loss or a divergence.

With the pinned jax brax 0.14.2's `ppo.train` raises (it calls `jax.device_put_replicated`, which is gone), and `apg.train`
takes no observation of several parts; `acting.generate_unroll`, the networks, the losses and `envs.training.wrap` run.
"""

import contextlib
import dataclasses
import io
from typing import Any

import jax
import jax.numpy as jnp

with contextlib.redirect_stdout(io.StringIO()):  # mujoco.mjx prints two lines where warp is not installed
    from brax.envs.base import Env
    from brax.envs.base import State as BraxState

from qjrl.control.environment import ResidualEnv
from qjrl.learning.ppo.environment import State, observation_sizes


class BraxResidualEnv(Env):
    """One arm of a `ResidualEnv`."""

    def __init__(self, env: ResidualEnv):
        self._env = env

    def reset(self, rng: jax.Array) -> BraxState:
        """A new episode of a raw or a typed key."""
        key = rng if jnp.issubdtype(rng.dtype, jax.dtypes.prng_key) else jax.random.wrap_key_data(rng)
        return _as_brax(_endless(self._env.reset(key[None])), {})

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        """One control period; an arm that is done has begun anew, its last observation is `info["final_obs"]`."""
        stepped = _endless(self._env.step(jax.tree.map(lambda row: row[None], state.pipeline_state), action[None]))
        found = _as_brax(stepped, state.info)
        state.metrics.update(found.metrics)  # wrappers keep metrics of their own there
        return found.replace(metrics=state.metrics)  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def observation_size(self) -> Any:
        """Name -> size."""
        return observation_sizes(self._env)

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return self._env.action_size

    @property
    def episode_length(self) -> int:
        """Control steps of an episode, for brax's wrappers."""
        return self._env.config.episode_steps

    @property
    def backend(self) -> str:
        """The engine's name; brax asks for it."""
        return type(self._env.engine).__name__


def _endless(state: State) -> State:
    """Without a time limit of its own."""
    steps = jnp.full_like(state.inner.episode.episode_steps, jnp.iinfo(jnp.int32).max)
    episode = dataclasses.replace(state.inner.episode, episode_steps=steps)
    return dataclasses.replace(state, inner=dataclasses.replace(state.inner, episode=episode))


def _as_brax(state: State, info: dict[str, Any]) -> BraxState:
    one: State = jax.tree.map(lambda rows: rows[0], state)
    done = one.terminated | ~one.valid
    info = info | {"final_obs": dict(one.final_observation)}
    metrics = {name: jnp.where(jnp.isfinite(value), value, 0.0) for name, value in one.metrics.items()}
    return BraxState(one, dict(one.observation), one.reward, done.astype(jnp.float32), metrics, info)  # pyright: ignore[reportArgumentType]
