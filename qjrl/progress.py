"""What a waiting person sees: a bar with rate and time left, "compiling …", one console for all lines.

On a terminal a bar is drawn; anywhere else (a file, a cluster log) a line is printed about every ten seconds.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

LINE_INTERVAL = 10.0
"""Seconds between two progress lines where there is no terminal."""


class Eye:
    """A stream for people: what it cannot show is shown otherwise or not at all, and never ends the work.

    A character that the encoding lacks becomes ``?``; a closed pipe or a full disk swallows the rest.
    """

    def __init__(self, stream: Any = None) -> None:
        self._stream, self._is_closed = stream, False

    @property
    def _target(self) -> Any:
        return sys.stdout if self._stream is None else self._stream

    def write(self, text: str) -> int:
        encoding = self.encoding
        self._try(lambda: self._target.write(text.encode(encoding, "replace").decode(encoding)))
        return len(text)

    def flush(self) -> None:
        self._try(lambda: self._target.flush())

    def isatty(self) -> bool:
        return bool(getattr(self._target, "isatty", lambda: False)()) and not self._is_closed

    def fileno(self) -> int:
        return self._target.fileno()

    @property
    def encoding(self) -> str:
        """Of the stream beneath; rich draws with what it has."""
        return getattr(self._target, "encoding", None) or "utf-8"

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)

    def _try(self, action: Callable[[], Any]) -> None:
        if self._is_closed or self._target is None:
            return
        try:
            action()
        except (OSError, ValueError):
            self._is_closed = True
            self._discard_the_rest()

    def _discard_the_rest(self) -> None:
        """What the stream still holds would be written, and fail, when Python ends."""
        try:
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), self._target.fileno())
        except (OSError, ValueError, AttributeError):
            return


console = Console(soft_wrap=True, highlight=False, file=Eye())  # pyright: ignore[reportArgumentType]
"""Every line of a run goes through here, so that lines and bars do not write over each other."""


@contextmanager
def track(total: int, label: str, already: int = 0) -> Iterator[Callable[..., None]]:
    """Shows the progress of a loop: ``with track(n, "settling") as advance: advance(1, note="3 unsettled")``.

    Args:
        total: number of steps (samples, epochs, environment steps) of the whole work.
        label: what is being done, one or two words.
        already: steps that an earlier, interrupted run has done; they do not count for the rate.
    """
    reporting = _bar if console.is_terminal else _lines
    with reporting(total, label, already) as advance:
        yield advance


@contextmanager
def compiling(what: str) -> Iterator[None]:
    """Says that XLA compiles, which takes seconds to minutes without any other sign of life."""
    console.print(f"compiling {what} …", markup=False)
    yield


@contextmanager
def _bar(total: int, label: str, already: int) -> Iterator[Callable[..., None]]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(label, total=total, completed=already, note="")

        def advance(steps: int = 1, note: str | None = None) -> None:
            if note is not None:
                progress.update(task, note=note)
            progress.advance(task, steps)

        yield advance


class _Rate(ProgressColumn):
    """Steps per second, as rich estimates it over the last half minute."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:,.3g}/s" if speed < 100 else f"{speed:,.0f}/s")


@contextmanager
def _lines(total: int, label: str, already: int) -> Iterator[Callable[..., None]]:
    start = last = time.monotonic()
    done, said, latest_note = already, -1, ""

    def say(now: float) -> None:
        nonlocal said
        said = done
        rate = (done - already) / max(now - start, 1e-9)
        left = (total - done) / rate if rate > 0 else float("inf")
        remaining = f", {_clock(left)} left" if done < total and left < float("inf") else ""
        line = f"{label}: {done:,}/{total:,} in {_clock(now - start)}, {rate:,.3g}/s{remaining}  {latest_note}"
        console.print(line.rstrip(), markup=False)

    def advance(steps: int = 1, note: str | None = None) -> None:
        nonlocal done, latest_note, last
        done, latest_note = done + steps, latest_note if note is None else note
        now = time.monotonic()
        if now - last >= LINE_INTERVAL:
            last = now
            say(now)

    yield advance
    if said != done:
        say(time.monotonic())


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
