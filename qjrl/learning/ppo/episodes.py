"""Returns and lengths of the episodes, and means of what the environment measures: for the log alone."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.learning.ppo.environment import State


@struct.dataclass
class EpisodeLog:
    """Follows the episodes of all envs, a row each. An episode with an invalid step is not counted."""

    returns: Any
    """(envs,) of the episodes under way."""
    lengths: Any
    """(envs,) int32."""
    sums: Mapping[str, Any]
    """Name -> (envs,): what is averaged since `cleared`, and how many of it there are, as `NAME/count`."""

    def after(self, state: State) -> "EpisodeLog":
        """One step later."""
        valid = state.valid & jnp.isfinite(state.reward)
        ended = state.terminated | state.truncated
        returns, lengths = self.returns + jnp.where(valid, state.reward, 0.0), self.lengths + 1
        finished = ended & valid
        means = {"return": (returns, finished), "episode_length": (lengths, finished)}
        for name, values in state.metrics.items():
            means |= {f"env/{name}": (values, valid), f"env_end/{name}": (values, finished)}
        sums = {}
        for name, (values, counts) in means.items():
            sums[name] = self.sums[name] + jnp.where(counts, values, 0.0)
            sums[f"{name}/count"] = self.sums[f"{name}/count"] + counts
        is_over = ended | ~valid
        return EpisodeLog(jnp.where(is_over, 0.0, returns), jnp.where(is_over, 0, lengths), sums)

    def cleared(self) -> "EpisodeLog":
        """With the same episodes under way and nothing to average yet."""
        return EpisodeLog(self.returns, self.lengths, jax.tree.map(jnp.zeros_like, dict(self.sums)))

    def totals(self) -> dict[str, jax.Array]:
        """The sums over all envs."""
        return {name: jnp.sum(values) for name, values in self.sums.items()}


def empty_log(count: int, metrics: Iterable[str]) -> EpisodeLog:
    """Of envs that begin; `metrics` are the names of what the environment measures."""
    names = ["return", "episode_length", *(f"{part}/{name}" for name in metrics for part in ("env", "env_end"))]
    sums = {name: jnp.zeros(count, jnp.float32) for name in names}
    counts = {f"{name}/count": jnp.zeros(count, jnp.int32) for name in names}
    return EpisodeLog(jnp.zeros(count, jnp.float32), jnp.zeros(count, jnp.int32), sums | counts)


def summary(totals: Mapping[str, Any]) -> dict[str, float | None]:
    """Means of `EpisodeLog.totals`; None where there is nothing finite to average.

    `env/NAME` is the mean over all valid steps, `env_end/NAME` over the last steps of episodes.
    """
    plain = {name: float(np.asarray(value)) for name, value in totals.items()}
    counts = {name: plain[f"{name}/count"] for name in plain if not name.endswith("/count")}
    means = {name: plain[name] / count if count else math.nan for name, count in counts.items()}
    finite = {name: mean if math.isfinite(mean) else None for name, mean in means.items()}
    return {"episodes": int(plain["return/count"])} | finite
