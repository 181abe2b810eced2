"""Output that made room for another: it stays beside it, and is taken back when it is wanted again. Nothing is deleted.

The latest lies in ``NAME.previous``, those before it in ``NAME.previous-2``, ``NAME.previous-3`` and so on, in the order
in which they made room.
"""

import re
from collections.abc import Callable
from pathlib import Path

_KEPT = re.compile(r"(.+)\.previous(?:-(\d+))?")


def is_kept(directory: Path) -> bool:
    """Whether a directory holds output that made room for another."""
    return _KEPT.fullmatch(directory.name) is not None


def kept_of(out: Path) -> list[Path]:
    """Everything that made room for `out`, the latest first."""
    matches = [(_KEPT.fullmatch(path.name), path) for path in out.parent.glob("*.previous*")] if out.name else []
    found = [(match[2], path) for match, path in matches if match and match[1] == out.name and path.is_dir()]
    return [path for _, path in sorted(found, key=lambda one: -(int(one[0]) if one[0] else 10**9))]


def move_away(out: Path) -> Path:
    """Moves a directory out of the way. Returns where it lies now."""
    latest = out.with_name(f"{out.name}.previous")
    if latest.exists():
        numbers = [int(match[2]) for path in kept_of(out) if (match := _KEPT.fullmatch(path.name)) and match[2]]
        latest.rename(out.with_name(f"{latest.name}-{max(numbers, default=1) + 1}"))
    out.rename(latest)
    return latest


def take_back(out: Path, is_wanted: Callable[[Path], bool]) -> Path | None:
    """Puts the latest kept directory that is wanted in the place of `out`, which makes room for it.

    Returns:
        Where it lay, or None if none is wanted.
    """
    wanted = next((path for path in kept_of(out) if is_wanted(path)), None)
    if wanted is None:
        return None
    if out.exists() and any(out.iterdir()):
        number = wanted.stat().st_ino
        move_away(out)
        back = next(path for path in kept_of(out) if path.stat().st_ino == number)  # it may have got a number just now
    else:
        back = wanted
        if out.exists():
            out.rmdir()
    back.rename(out)
    return wanted
