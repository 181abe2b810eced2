"""Many runs by one command: where they go, what identifies them, and the table at the end."""

import dataclasses
import secrets
from pathlib import Path

from qjrl import pipeline, progress, sweep
from qjrl.cli.arguments import quoted
from qjrl.cli.names import job_name
from qjrl.config import conf_folder


@dataclasses.dataclass(frozen=True)
class Job:
    """What a run is told by the command that starts it, in this process or in a worker."""

    files: dict[str, str]
    """Choice of a robot -> the user's file."""
    typed: dict[str, str]
    """Override as Hydra was given it -> as the user typed it."""
    sweep: str | None = None
    """Identity of the sweep that it belongs to."""
    fixed: tuple[str, ...] = ()
    """Keys that are the same in all runs of the sweep."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """A sweep before it starts."""

    directory: Path
    identity: str
    """What its runs are known by, whatever the clocks of their machines say."""
    fixed: tuple[str, ...]
    overrides: list[str]
    """For Hydra: where the sweep goes, and that its runs are named by what is swept."""


def plan(texts: list[str]) -> Plan:
    """The plan of a sweep over the overrides of a command."""
    from hydra import compose, initialize_config_dir
    from hydra.core.override_parser.overrides_parser import OverridesParser

    overrides = OverridesParser.create().parse_overrides(texts)
    fixed = [override for override in overrides if not override.is_sweep_override()]
    with initialize_config_dir(version_base=None, config_dir=str(conf_folder())):
        composed = compose("config", [str(override.input_line) for override in fixed], return_hydra_config=True)
    directory, keys = str(composed.hydra.sweep.dir), tuple(override.key_or_group for override in fixed)
    pinned = [
        f"hydra.sweep.dir={quoted(directory)}",
        f"hydra.job.config.override_dirname.exclude_keys=[{','.join(quoted(key) for key in keys)}]",
    ]
    return Plan(Path(directory), secrets.token_hex(8), keys, pinned)


def directory_of_all_parts(job: Job, run_dir: Path, sweep_dir: str, overrides: list[str]) -> Path:
    """The directory of a run: its own, except that runs which differ only in their part of a stage share one."""
    swept = sorted(text for text in overrides if _key(text) not in job.fixed)
    kept = [text for text in swept if _key(text) not in pipeline.PART_KEYS]
    if kept == swept:
        return run_dir
    return Path(sweep_dir) / job_name(",".join(kept)) if kept else Path(sweep_dir)


def _key(override: str) -> str:
    return override.partition("=")[0].lstrip("+~")


def finish(planned: Plan) -> int:
    """Prints and writes the table over the runs. Returns the exit code."""
    from rich.markup import escape
    from rich.table import Table

    rows = sweep.gather(planned.directory, planned.identity)
    sweep.write(planned.directory, rows)
    shown = sweep.headline(rows)
    headers = ["\n".join(key.split(".")[-3:]) for key in shown]
    table = Table("job", "status", "seconds", *headers, title=escape(str(planned.directory)))
    for row in rows:
        errors = [f"{row['metrics'][key]:.3f}" if key in row["metrics"] else "" for key in shown]
        seconds = "" if row["seconds"] is None else f"{row['seconds']:.0f}"
        table.add_row(*(escape(text) for text in (row["job"], row["error"] or row["status"], seconds, *errors)))
    progress.console.print(table)
    return 0 if rows and all(row["status"] == "done" for row in rows) else 1
