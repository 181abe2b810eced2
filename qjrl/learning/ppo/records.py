"""A line of a training's log, and when its numbers end the training."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.episodes import summary

Record = dict[str, Any]


def record_of(metrics: Mapping[str, np.ndarray]) -> Record:
    """The metrics of `iteration.learning`, on the host, as a record."""
    rest = dict(metrics)
    num_valid, num_steps, reward_sum = (rest.pop(name).item() for name in ("num_valid", "num_steps", "reward_sum"))
    log = {name.removeprefix("log/"): rest.pop(name) for name in list(rest) if name.startswith("log/")}
    losses = {name: float(value) for name, value in rest.items()}
    reward = reward_sum / num_valid if num_valid else None
    return summary(log) | {"reward": reward} | validity_of(num_valid, num_steps) | losses


def validity_of(num_valid: int, num_steps: int) -> Record:
    """How many steps diverged."""
    return {"invalid": num_steps - num_valid, "invalid_fraction": 1 - num_valid / num_steps}


def check_validity(
    record: Record, iteration: int, config: PPOConfig, evidence: Callable[[], dict[str, np.ndarray]]
) -> None:
    """Raises `TrainingDiverged`, with what `evidence` says, where too many steps diverged."""
    if record["invalid_fraction"] > config.max_invalid_fraction:
        raise TrainingDiverged(
            f"iteration {iteration}: {record['invalid_fraction']:.1%} of the steps diverged or were not finite, "
            f"allowed: {config.max_invalid_fraction:.1%} (max_invalid_fraction)",
            evidence(),
        )


def check_losses(record: Record, iteration: int) -> None:
    """Raises `TrainingDiverged` where a loss is no number."""
    broken = [name for name in ("policy_loss", "value_loss", "entropy", "kl") if not math.isfinite(record[name])]
    if broken:
        raise TrainingDiverged(f"iteration {iteration}: {', '.join(broken)} not finite; try a smaller learning_rate")


def note_of(record: Record) -> str:
    """What the progress bar says of it."""
    shown = ((name, record.get(name)) for name in ("return", "reward", "std", "kl"))
    return ", ".join(f"{name} {value:.3g}" for name, value in shown if value is not None)
