"""Hands a command to Hydra, and runs the stages in each of the jobs that come back."""

import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from qjrl import pipeline, progress, sweep
from qjrl.artifacts import ArtifactError
from qjrl.cli import arguments as words
from qjrl.cli import names, outcome, process, sweeps
from qjrl.cli.robot_files import as_typed, with_robot_files
from qjrl.cli.sweeps import Job
from qjrl.config import ConfigError, conf_folder, known_names, unknown_key


def launch(arguments: list[str]) -> int:
    """Runs a command. Returns the exit code; every error of Hydra's own becomes one line."""
    import hydra

    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions come here instead of being printed by Hydra
    overrides, options = words.sorted_out(arguments, pipeline.STAGES)
    names.register()
    overrides, files = with_robot_files(overrides)
    overrides = [words.for_hydra(override) for override in overrides]
    is_sweep = bool({"-m", "--multirun"} & set(options))
    outcomes: list[str] = []
    planned = None
    try:
        planned = sweeps.plan(overrides) if is_sweep else None
        job = Job(files, planned.identity, planned.fixed) if planned else Job(files)
        sys.argv = ["qjrl", *overrides, *(planned.overrides if planned else []), *options]
        hydra.main(version_base=None, config_path=str(conf_folder()), config_name="config")(_job(job, outcomes))()
    except Exception as error:
        told = error if outcome.explained(error) else _told_by_hydra(error, overrides)
        if told is not None:
            return outcome.EXIT_CODES[outcome.tell(told)[0]]
        traceback.print_exc()  # of a launcher: a worker was killed, a queue refused; jobs report their own
        outcomes.append("failed")
    if planned is not None:
        return max(sweeps.finish(planned), "failed" in outcomes)
    return outcome.EXIT_CODES[outcomes[-1]] if outcomes else 0


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
    overrides = list(about.overrides.task)
    is_first = not OmegaConf.select(cfg, "processes.index")  # of several processes one keeps the record
    with sweep.recorded(run_dir, as_typed(overrides, job.files), job.sweep, is_first) as record:
        together = (
            run_dir if job.sweep is None else sweeps.directory_of_all_parts(job, run_dir, about.sweep.dir, overrides)
        )
        tree: Any = OmegaConf.to_container(cfg, resolve=True)
        record["status"], record["error"] = run_stages(tree, together)
    return record["status"]


def run_stages(tree: dict[str, Any], run_dir: Path) -> tuple[str, str | None]:
    """Runs the stages. Returns the status and the line that explains it, already printed."""
    try:
        selected = pipeline.selected(tree)
        pipeline.meet(tree)
        progress.console.print(f"{', '.join(selected)} -> {run_dir}", markup=False)
        pipeline.run(selected, pipeline.build_needed(tree, selected), run_dir)
    except Exception as error:
        return outcome.tell(error)
    report = run_dir / "compare" / "report.html"
    progress.console.print(f"done: {report if 'compare' in selected and report.exists() else run_dir}", markup=False)
    return "done", None


# --- Hydra's errors ---------------------------------------------------------------------------------------------------


def _told_by_hydra(error: Exception, overrides: list[str]) -> Exception | None:
    """Hydra's error as one in our words; None: it is nothing that the input explains."""
    import yaml
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, (ConfigError, ArtifactError)):
            return cause
        cause = cause.__cause__ or cause.__context__
    known = (HydraException, OmegaConfBaseException, yaml.YAMLError, OSError, ValueError)
    if isinstance(error, known):
        return _readable(error, overrides)
    if _is_raised_by(error, ("hydra", "omegaconf", "antlr4")):  # it meets a value that it did not expect
        return ConfigError(f"{' '.join(overrides)}: Hydra cannot read this ({type(error).__name__}: {error})")
    return None


def _is_raised_by(error: Exception, packages: tuple[str, ...]) -> bool:
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return place is not None and place.tb_frame.f_globals.get("__name__", "").partition(".")[0] in packages


def _readable(error: Exception, overrides: list[str]) -> Exception:
    from hydra.errors import MissingConfigException
    from omegaconf.errors import OmegaConfBaseException

    if isinstance(error, MissingConfigException) and error.options is not None:
        group, _, choice = (error.missing_cfg_file or "").rpartition("/")
        return ConfigError(f"{group}: got '{choice}', {known_names(choice, error.options)}")
    cause = error.__cause__
    if isinstance(cause, OmegaConfBaseException) and cause.full_key and "not in struct" in str(cause):
        values = [value for key, _, value in (text.partition("=") for text in overrides) if cause.full_key in key]
        known = [key for key in getattr(cause.parent_node, "keys", list)() if key != "hydra"]
        return unknown_key(cause.full_key, values[0] if values else None, known)
    text, override = str(error).partition("\nSee http")[0], getattr(error, "override", None)
    if "Ambiguous value" in text:
        several = "several values; add -m (--multirun) to run each of them, or write [a,b] for a list"
        return ConfigError(f"{override or text.partition(chr(10))[0]}: {several}")
    if text.startswith("LexerNoViableAlt"):
        return ConfigError(
            f"{override or text}: cannot be read; a value with such letters needs quotes: KEY=\"'VALUE'\""
        )
    return ConfigError(f"{override}: {text}" if override and override not in text else text)
