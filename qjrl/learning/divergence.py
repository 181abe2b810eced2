"""What a training raises when its numbers are no longer numbers, and what it then knows of them."""

from collections.abc import Mapping

import numpy as np


class TrainingDiverged(RuntimeError):  # noqa: N818
    """Too many samples, or the loss itself, are not finite. The message says which, how many, and what to try."""

    def __init__(self, message: str, evidence: Mapping[str, np.ndarray] | None = None) -> None:
        super().__init__(message)
        self.evidence = dict(evidence or {})
        """What is known of the samples, a row each; empty where nothing is."""
