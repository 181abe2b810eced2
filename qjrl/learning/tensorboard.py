"""Records of a training as TensorBoard events."""

from collections.abc import Callable
from pathlib import Path
from typing import Any


def tensorboard(directory: Path, counter: str = "env_steps") -> Callable[[dict[str, Any]], None]:
    """A callback that writes every number of a record as a scalar, over `counter`."""
    from tensorboardX import SummaryWriter

    writer = SummaryWriter(str(directory))

    def write(record: dict[str, Any]) -> None:
        for name, value in record.items():
            if isinstance(value, int | float):
                writer.add_scalar(name, value, record[counter])
        writer.flush()

    return write
