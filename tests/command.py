"""The command as a user meets it, in this process to save time: exit code, and what it says."""

import dataclasses
import sys
from collections.abc import Callable

from qjrl.__main__ import main


@dataclasses.dataclass
class Said:
    """What a command left behind."""

    code: int
    out: str
    err: str


Command = Callable[..., Said]


def run_command(monkeypatch, capsys, *arguments: str) -> Said:
    """``qjrl ARGUMENTS`` in the current directory."""
    monkeypatch.setattr(sys, "argv", ["qjrl", *arguments])
    code = main()
    return Said(code, *capsys.readouterr())


def assert_one_line(said: Said, *words: str, code: int | tuple[int, ...] = 2) -> None:
    """One line on stderr that holds `words`, no traceback, and the exit code."""
    assert said.code in ((code,) if isinstance(code, int) else code), (said.code, said.err)
    assert len(said.err.splitlines()) == 1, said.err
    assert "Traceback" not in said.out + said.err
    for word in words:
        assert word in said.err, said.err
