"""Hands a command to Hydra, and runs the stages in each of the jobs that come back."""

import errno
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from qjrl import pipeline, progress, sweep
from qjrl.cli import arguments as words
from qjrl.cli import defaults, hydra_errors, names, outcome, process, sweeps
from qjrl.cli.robot_files import as_typed, with_robot_files
from qjrl.cli.sweeps import Job
from qjrl.cli.values import checked
from qjrl.config import ConfigError, conf_folder, in_file
from qjrl.machine import MachineError


def launch(arguments: list[str]) -> int:
    """Runs a command. Returns the exit code; every error of Hydra's own becomes one line."""
    import hydra

    _require_directory()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions come here instead of being printed by Hydra
    overrides, options = words.sorted_out(arguments, pipeline.STAGES)
    is_sweep = bool({"-m", "--multirun"} & set(options))
    names.register()
    overrides, files = with_robot_files(overrides)
    plain = checked(overrides, is_sweep, words.TEXTS)
    typed = {words.for_hydra(one): override for one, override in zip(plain, overrides, strict=True)}
    overrides = list(map(words.for_hydra, plain))
    defaults.register_for(overrides, options)
    outcomes: list[str] = []
    planned = None
    try:
        planned = sweeps.plan(overrides) if is_sweep else None
        job = Job(files, typed, planned.identity, planned.fixed) if planned else Job(files, typed)
        sys.argv = ["qjrl", *overrides, *(planned.overrides if planned else []), *options]
        hydra.main(version_base=None, config_path=str(conf_folder()), config_name="config")(_job(job, outcomes))()
    except Exception as problem:
        error = _of_the_place(problem)
        told = error if outcome.explained(error) else hydra_errors.in_our_words(error, overrides)
        if told is not None:
            return outcome.EXIT_CODES[outcome.tell(told)[0]]
        traceback.print_exc()  # of a launcher: a worker was killed, a queue refused; jobs report their own
        outcomes.append("failed")
    if planned is not None:
        return max(sweeps.finish(planned), "failed" in outcomes)
    return outcome.EXIT_CODES[outcomes[-1]] if outcomes else 0


def _require_directory() -> None:
    """Raises a MachineError where the current directory has been deleted."""
    try:
        os.getcwd()
    except OSError as error:
        raise MachineError("the current directory does not exist any more; go to one that does (cd)") from error


def _of_the_place(error: Exception) -> Exception:
    """An error of the directories that Hydra makes for the runs, as one of the machine; any other as it is."""
    if not isinstance(error, OSError) or error.errno == errno.ENAMETOOLONG or error.filename is None:
        return error
    place = Path(os.fsdecode(error.filename))
    why = f"it is a link to {os.readlink(place)}, which does not exist" if place.is_symlink() else error.strerror
    return MachineError(f"{place}: cannot be made or written to, where the output goes ({why})")


def _job(job: Job, outcomes: list[str]) -> Callable[[Any], str]:
    """The function that Hydra calls once per run, here or in a worker; it tells errors itself and never raises them."""

    def run(cfg: Any) -> str:
        process.prepare()
        try:
            status = _recorded_run(cfg, job)
        except Exception as error:  # of the record, on a disk that is full
            status, _ = outcome.tell(error)
        outcomes.append(status)
        return status

    return run


def _recorded_run(cfg: Any, job: Job) -> str:
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    about = HydraConfig.get()
    run_dir = Path(os.path.relpath(about.runtime.output_dir))
    overrides: Any = OmegaConf.to_container(
        about.overrides.task, resolve=False
    )  # as typed, what they refer to included
    tree, problem = _resolved(cfg, overrides)
    is_first = not _index(tree)  # of several processes one keeps the record
    typed: list[str] = [job.typed.get(one, one) for one in map(str, overrides)]
    with sweep.recorded(run_dir, as_typed(typed, job.files), job.sweep, is_first) as record:
        together = (
            run_dir if job.sweep is None else sweeps.directory_of_all_parts(job, run_dir, about.sweep.dir, overrides)
        )
        file = _file_of_robot(job, typed, str(about.runtime.choices.get("robot")))
        record["status"], record["error"] = outcome.tell(problem) if problem else run_stages(tree, together, file)
    return record["status"]


def _resolved(cfg: Any, overrides: list[str]) -> tuple[dict[str, Any], Exception | None]:
    """The configuration as plain dicts and lists, or what is wrong with a value that refers to another."""
    from omegaconf import OmegaConf

    try:
        said: Any = OmegaConf.to_container(cfg, resolve=False)
        if "${" in str(said):  # what it refers to may be a default
            cfg = OmegaConf.merge(defaults.of_groups(said), cfg)
        tree: Any = OmegaConf.to_container(cfg, resolve=True)
    except Exception as error:
        return {}, hydra_errors.in_our_words(error, overrides) or error
    return tree, None


def _index(tree: dict[str, Any]) -> Any:
    processes = tree.get("processes")
    return processes.get("index") if isinstance(processes, dict) else None


def _file_of_robot(job: Job, overrides: list[str], choice: str) -> str | None:
    """The user's file that all values of the robot come from; None where the command changes some of them."""
    changes = any(override.lstrip("+~").startswith("robot.") for override in overrides)
    return None if changes else job.files.get(choice)


def run_stages(tree: dict[str, Any], run_dir: Path, robot_file: str | None = None) -> tuple[str, str | None]:
    """Runs the stages. Returns the status and the line that explains it, already printed.

    Args:
        robot_file: the user's, which errors of the robot's values name.
    """
    try:
        selected = pipeline.selected(tree)
        pipeline.meet(tree)
        progress.console.print(f"{', '.join(selected)} -> {run_dir}", markup=False)
        pipeline.run(selected, pipeline.build_configs(tree, selected), run_dir)
    except Exception as error:
        if robot_file is not None and isinstance(error, ConfigError):
            error = in_file(robot_file, error)
        return outcome.tell(error)
    report = run_dir / "compare" / "report.html"
    progress.console.print(f"done: {report if 'compare' in selected and report.exists() else run_dir}", markup=False)
    return "done", None
