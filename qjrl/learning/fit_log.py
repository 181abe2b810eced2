"""The log of a fit, `progress.jsonl`: errors and clocks of every evaluation, going on after an interruption."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from qjrl import artifacts
from qjrl.learning import checkpoints as ckpt


class FitLog:
    """`progress.jsonl`: one line an evaluation; both clocks go on counting where an interrupted fit stopped."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.last: dict[str, Any] = {}
        self.start = self.cpu_start = 0.0

    def rewind(self, done: int | None) -> None:
        """Go on after the evaluation of epoch `done`; None: from the start."""
        kept = ckpt.rewind_log(self.path, "epoch", -1 if done is None else done)
        self.last = kept[-1] if kept else {}
        self.start = time.monotonic() - self.last.get("seconds", 0.0)
        self.cpu_start = time.process_time() - self.last.get("cpu_seconds", 0.0)

    def append(self, epoch: int, step: int, train_loss: float | None, metrics: Mapping[str, float]) -> None:
        """Write one evaluation."""
        clocks = {"seconds": time.monotonic() - self.start, "cpu_seconds": time.process_time() - self.cpu_start}
        rounded = {name: round(value, 3) for name, value in clocks.items()}
        self.last = {"epoch": epoch, "step": step, "train_loss": train_loss, **metrics, **rounded}
        artifacts.append_json_line(self.path, self.last)

    def note(self, minimise: str) -> str:
        """The last value of a metric, for the progress bar."""
        return f"{minimise} {self.last[minimise]:.4g}"
