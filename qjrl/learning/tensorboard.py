"""Records of a training as TensorBoard events."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def tensorboard(directory: Path, counter: str = "env_steps") -> Iterator[Callable[[dict[str, Any]], None]]:
    """A callback that writes every number of a record as a scalar, over `counter`; all is on disk at the end."""
    from tensorboardX import SummaryWriter

    writer = SummaryWriter(str(directory), flush_secs=10)

    def write(record: dict[str, Any]) -> None:
        for name, value in record.items():
            if isinstance(value, int | float):
                writer.add_scalar(name, value, record[counter])

    try:
        yield write
    finally:
        writer.close()
