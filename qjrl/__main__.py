"""The command ``qjrl``: exit code 0 done, 1 failed (the machine, a bug), 2 bad input, 130 interrupted. See `cli`."""

import contextlib
import shlex
import sys

from qjrl import __version__, progress
from qjrl.cli import outcome
from qjrl.cli.launch import launch
from qjrl.cli.overview import overview


def main() -> int:
    """The console script. Returns the exit code."""
    streams = progress.Eye(sys.stdout), progress.Eye(sys.stderr)
    with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):  # pyright: ignore[reportArgumentType]
        return _main(sys.argv[1:])


def _main(arguments: list[str]) -> int:
    if {"-h", "--help"} & set(arguments):
        print(overview(), end="")
        return 0
    if "--version" in arguments:
        print(f"qjrl {__version__}")
        return 0
    try:
        return launch(arguments)
    except KeyboardInterrupt:
        print(f"\ninterrupted; to go on: {shlex.join(['qjrl', *arguments])}", file=sys.stderr)
        return 130
    except Exception as error:
        return outcome.EXIT_CODES[outcome.tell(error)[0]]


if __name__ == "__main__":
    from qjrl.__main__ import main as importable_main  # workers of a launcher import the job by name

    sys.exit(importable_main())
