"""Returns and lengths of the episodes, and means of what the environment measures: for the log alone."""

import math
from collections import defaultdict
from collections.abc import Mapping

import numpy as np

from qjrl.learning.ppo.environment import Transition


class EpisodeLog:
    """Follows the episodes of all copies. An episode with an invalid step is not counted."""

    def __init__(self, num_envs: int) -> None:
        self.returns = np.zeros(num_envs, np.float32)
        self.lengths = np.zeros(num_envs, np.int32)
        self._forget()

    def add(self, transition: Transition) -> None:
        """Takes in one step of all copies."""
        valid = np.asarray(transition.valid, bool) & np.isfinite(np.asarray(transition.reward))
        ended = np.asarray(transition.terminated, bool) | np.asarray(transition.truncated, bool)
        self.returns += np.where(valid, transition.reward, 0)
        self.lengths += 1
        self._finished_returns.extend(self.returns[ended & valid].tolist())
        self._finished_lengths.extend(self.lengths[ended & valid].tolist())
        self.returns[ended | ~valid] = 0
        self.lengths[ended | ~valid] = 0
        for name, values in transition.metrics.items():
            values = np.asarray(values)
            self._add_mean(f"env/{name}", values[valid])
            self._add_mean(f"env_end/{name}", values[ended & valid])

    def summary(self) -> dict[str, float | None]:
        """Means since the last call; None where there is nothing finite to average.

        `env/NAME` is the mean over all valid steps, `env_end/NAME` over the last steps of episodes.
        """
        means = {name: total / count if count else None for name, (total, count) in self._sums.items()}
        means = {name: mean if mean is None or math.isfinite(mean) else None for name, mean in means.items()}
        returns, lengths = self._finished_returns, self._finished_lengths
        episodes = {
            "episodes": len(returns),
            "return": float(np.mean(returns)) if returns else None,
            "episode_length": float(np.mean(lengths)) if lengths else None,
        }
        self._forget()
        return episodes | means

    def get_state(self) -> dict[str, np.ndarray]:
        """The episodes under way; the sums since the last `summary` are not part of it."""
        return {"returns": self.returns.copy(), "lengths": self.lengths.copy()}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Goes back to what `get_state` returned."""
        self.returns, self.lengths = state["returns"].copy(), state["lengths"].copy()

    def _add_mean(self, name: str, values: np.ndarray) -> None:
        sums = self._sums[name]
        sums[0] += float(values.sum())
        sums[1] += len(values)

    def _forget(self) -> None:
        self._finished_returns: list[float] = []
        self._finished_lengths: list[int] = []
        self._sums: dict[str, list[float]] = defaultdict(lambda: [0.0, 0])
