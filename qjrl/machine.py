"""Errors of the machine: a full disk, no device, no right to write. They say nothing about the input.

The door decides by `line_of` whether an error is one of these (one line, exit code 1) or a bug (a traceback).
"""

import errno
from typing import Any


class MachineError(RuntimeError):
    """The machine cannot do what is asked. The message is the one line a user reads."""


_OF_THE_INPUT = (errno.ENOENT, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG, errno.EINVAL, errno.ELOOP)
"""Where a file that the user names is read: it is not there, or is no file."""
_OF_A_BUG = (errno.ENOENT, errno.EBADF, errno.EINVAL)
"""Where nobody expected an error: more likely a mistake in the program."""
_FROM_XLA = ("RESOURCE_EXHAUSTED", "UNAVAILABLE", "DEADLINE_EXCEEDED", "Unable to initialize backend")


def is_of_input(error: OSError) -> bool:
    """Whether reading a file that the user names failed for its name, not for the disk or the rights."""
    return error.errno is None or error.errno in _OF_THE_INPUT


def line_of(error: BaseException) -> str | None:
    """One line about an error of the machine, or None if `error` and its causes are something else."""
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:
        seen.add(id(cause))
        if line := _line(cause):
            return " ".join(line.split())
        cause = cause.__cause__
    return None


def _line(error: BaseException) -> str | None:
    text = str(error)
    if isinstance(error, MachineError):
        return text
    if isinstance(error, MemoryError):
        return f"out of memory{f': {text}' if text else ''}; a smaller batch, or fewer rows, takes less"
    if isinstance(error, OSError) and error.errno is not None and error.errno not in _OF_A_BUG:
        place = f"{error.filename}: " if error.filename is not None else ""
        hint = "; make room, then the same command goes on" if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
        return f"{place}{error.strerror}{hint}"
    if isinstance(error, OSError) and "requested and" in text and "written" in text:  # of numpy, on a full disk
        return "No space left on device; make room, then the same command goes on"
    if isinstance(error, RuntimeError) and any(word in text for word in _FROM_XLA):
        return text.partition("\n")[0]
    return None


def require_device() -> Any:
    """JAX's devices; asked for once, before any stage needs one.

    Raises:
        MachineError: there is none of the kind that is asked for, or JAX does not start.
    """
    platforms = None
    try:
        import jax

        platforms = jax.config.jax_platforms  # pyright: ignore[reportAttributeAccessIssue]
        return jax.devices()
    except Exception as error:
        asked = f" for JAX_PLATFORMS={platforms}" if platforms else ""
        reason = " ".join(str(error).split("\n")[0].split())
        raise MachineError(f"JAX finds no device{asked}{f' ({reason})' if reason else ''}") from error
