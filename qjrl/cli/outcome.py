"""How a run ends: which errors are one line, and with which exit code; anything else is a bug and shows its traceback."""

import sys
import traceback
from typing import Literal

from qjrl import machine
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError
from qjrl.learning.divergence import TrainingDiverged

Status = Literal["done", "bad input", "failed"]
EXIT_CODES: dict[str, int] = {"done": 0, "failed": 1, "bad input": 2}


def explained(error: BaseException) -> tuple[Status, str] | None:
    """Status and line of an error that is nobody's bug: the machine's, the input's, a training that diverged."""
    if line := machine.line_of(error):
        return "failed", line
    if isinstance(error, TrainingDiverged):
        return "failed", str(error)
    if isinstance(error, (ConfigError, ArtifactError)):
        return "bad input", str(error)
    return None


def tell(error: BaseException) -> tuple[Status, str]:
    """Prints the line of an error, or its traceback. Returns the status and the line."""
    told = explained(error)
    if told is None:
        traceback.print_exception(error)
        return "failed", f"{type(error).__name__}: {error}"
    print(one_line(told[1]), file=sys.stderr)
    return told


def one_line(text: str) -> str:
    """The text on one line, without what a terminal would obey."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
