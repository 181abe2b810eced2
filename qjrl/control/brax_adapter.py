"""The residual environment as brax's `Env` of one arm, so that brax's wrappers and trainers' parts run on it.

One arm is a batch of one; `jax.vmap` of it is a batch again, so there is no second implementation. Brax's episodes end
in its own wrappers: `done` is the arm's loss, its time limit or a divergence, `info["truncation"]` the time limit.

With the pinned jax brax 0.14.2's `ppo.train`, `sac.train` and `apg.train` raise (they call `jax.device_put_replicated`, which is
gone); `acting.generate_unroll`, the networks, the losses and `envs.training.wrap` run.
"""

import contextlib
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
        return _as_brax(self._env.reset(key[None]), {})

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        """One control period; an arm whose episode ended has begun anew, its last observation is `info["final_obs"]`."""
        stepped = self._env.step(jax.tree.map(lambda row: row[None], state.pipeline_state), action[None])
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
    def backend(self) -> str:
        """The engine's name; brax asks for it."""
        return type(self._env.engine).__name__


def _as_brax(state: State, info: dict[str, Any]) -> BraxState:
    one: State = jax.tree.map(lambda rows: rows[0], state)
    done = one.terminated | one.truncated | ~one.valid
    info = info | {"truncation": one.truncated.astype(jnp.float32), "final_obs": dict(one.final_observation)}
    metrics = {name: jnp.where(jnp.isfinite(value), value, 0.0) for name, value in one.metrics.items()}
    return BraxState(one, dict(one.observation), one.reward, done.astype(jnp.float32), metrics, info)  # pyright: ignore[reportArgumentType]
