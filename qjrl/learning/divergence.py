"""What a training raises when its numbers are no longer numbers, and what it then knows of them."""

from collections.abc import Mapping

import numpy as np

# Of the steps in which copies diverge the first ones show the cause; the others are only counted.
_MOST_STEPS_KEPT = 20


class TrainingDiverged(RuntimeError):  # noqa: N818
    """Too many samples, or the loss itself, are not finite. The message says which, how many, and what to try."""

    def __init__(self, message: str, evidence: Mapping[str, np.ndarray] | None = None) -> None:
        super().__init__(message)
        self.evidence = dict(evidence or {})
        """What is known of the samples, a row each; empty where nothing is."""


class Evidence:
    """What is known of the copies that diverged, step by step."""

    def __init__(self) -> None:
        self._steps: list[dict[str, np.ndarray]] = []

    def add(self, diverged: Mapping[str, np.ndarray], step: int) -> None:
        """Takes in `Transition.diverged` of a step, empty where all is well."""
        if diverged and len(self._steps) < _MOST_STEPS_KEPT:
            count = len(next(iter(diverged.values())))
            self._steps.append({"rollout_step": np.full(count, step), **diverged})

    def arrays(self) -> dict[str, np.ndarray]:
        """Name -> rows of all steps, and `rollout_step`; empty if nothing diverged or nothing is known."""
        names = self._steps[0] if self._steps else ()
        return {name: np.concatenate([step[name] for step in self._steps]) for name in names}
