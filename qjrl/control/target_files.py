"""The files of targets that stage `ik` writes, as later stages read them."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from qjrl import artifacts

TARGET_COLUMNS = ("target_set", "target", "nominal_lengths", "learned_lengths")
"""Of both files: targets, and what the closed form and the model answer."""


def read_targets(path: Path, names: Collection[str] = TARGET_COLUMNS) -> dict[str, np.ndarray]:
    """The columns of `held_out.npz` or `bank.npz`.

    Raises:
        ArtifactError: the file is damaged or lacks one of `names`.
    """
    return artifacts.load_columns(path, names, "what stage ik writes")
