"""The door: ``qjrl`` composes the configuration with Hydra, checks it and runs the stages.

The only file that knows hydra, the process environment and exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted.
"""

import ctypes
import logging
import os
import platform
import shlex
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from qjrl import __version__, pipeline, progress, sweep
from qjrl.artifacts import ArtifactError, hash_of
from qjrl.config import ConfigError, conf_folder, known_names, read_yaml, unknown_key
from qjrl.learning.divergence import TrainingDiverged

HELP = """\
qjrl {version}: the toolkit for cable-driven arms made of quaternion joints

  qjrl [stages=[...]] [GROUP=CHOICE] [+experiment=NAME] [KEY=VALUE ...] [-m]

Stages, in the order of the data flow; each writes to outputs/NAME/DIRECTORY
{stages}
On demand (stages=[...])
{on_demand}
Groups (* is the default)
{groups}
Values
  qjrl --cfg job          prints every key with its value; keys are dotted: sample.num_samples=4096
  name=NAME seed=INTEGER  name of the directory under outputs/, seed of everything random

Examples
  qjrl                                           the whole pipeline at the size of a small computer
  qjrl +experiment=smoke                         the whole pipeline in a minute or so, to see it work
  qjrl stages=[sample,forward_model] sample.num_samples=4096
  qjrl stages=[describe] robot=my_arm.yaml       your own arm, from your own file
  qjrl -m seed=1,2 forward_model=paper,corrected +experiment=smoke hydra/launcher=joblib

The same command again skips what is done and goes on where it was interrupted.
"""


def main() -> int:
    """The console script. Returns the exit code."""
    arguments = sys.argv[1:]
    if {"-h", "--help"} & set(arguments):
        print(_help(), end="")
        return 0
    if "--version" in arguments:
        print(f"qjrl {__version__}")
        return 0
    try:
        shared = Path.cwd() if any("submitit_slurm" in argument for argument in arguments) else None  # other machines
        with tempfile.TemporaryDirectory(prefix=".qjrl-", dir=shared) as folder:
            return _launch(_with_robot_files(arguments, Path(folder)))
    except (ConfigError, ArtifactError) as error:
        return _complain(error)
    except KeyboardInterrupt:
        print(f"\ninterrupted; to go on: {shlex.join(['qjrl', *arguments])}", file=sys.stderr)
        return 130


def _help() -> str:
    stages = {True: "", False: ""}
    for name, stage in pipeline.STAGES.items():
        stages[stage.default] += f"  {name:<15} {stage.summary} ({stage.writes}/)\n"
    return HELP.format(version=__version__, stages=stages[True], on_demand=stages[False], groups=_groups())


def _groups() -> str:
    defaults = {group: choice for entry in read_yaml(conf_folder() / "config.yaml")["defaults"]
                if isinstance(entry, dict) for group, choice in entry.items()}  # fmt: skip
    text = ""
    for folder in sorted(path for path in conf_folder().iterdir() if path.is_dir()):
        choices = [path.stem + "*" * (defaults.get(folder.name) == path.stem) for path in sorted(folder.glob("*.yaml"))]
        name = "+experiment" if folder.name == "experiment" else folder.name
        own = ", or a file: robot=my_arm.yaml" if folder.name == "robot" else ""
        text += f"  {name:<15} {', '.join(choices)}{own}\n"
    return text


def _launch(arguments: list[str]) -> int:
    """Hands the arguments to Hydra; every error of Hydra's own becomes one line."""
    import hydra
    import yaml
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions come here instead of being printed by Hydra
    outcomes: list[str] = []
    is_sweep = bool({"-m", "--multirun"} & set(arguments))
    arguments = ["--multirun"] * is_sweep + [text for text in arguments if text not in ("-m", "--multirun")]
    since, sweep_dir = time.time(), None
    try:
        sweep_dir, pinned = _pinned_sweep(arguments) if is_sweep else (None, [])
        sys.argv = ["qjrl", *arguments, *pinned]
        hydra.main(version_base=None, config_path=str(conf_folder()), config_name="config")(_job(outcomes))()
    except (HydraException, OmegaConfBaseException, yaml.YAMLError, OSError, ValueError) as error:
        return _complain(_readable(error, arguments))
    except Exception:  # of a launcher: a worker was killed, a queue refused; jobs report their own
        traceback.print_exc()
        outcomes.append("failed")
    if sweep_dir is not None:
        return max(_finish_sweep(sweep_dir, since), "failed" in outcomes)
    return {"done": 0, "bad input": 2, "failed": 1}[outcomes[-1]] if outcomes else 0


def _job(outcomes: list[str]) -> Callable[[Any], str]:
    """The function that Hydra calls once per run; it reports errors itself and never raises them."""

    def job(cfg: Any) -> str:
        from hydra.core.hydra_config import HydraConfig
        from omegaconf import OmegaConf

        _prepare_process()
        run_dir = Path(os.path.relpath(HydraConfig.get().runtime.output_dir))
        is_first = not OmegaConf.select(cfg, "processes.index")  # of several processes one keeps the record
        with sweep.recorded(run_dir, list(HydraConfig.get().overrides.task), is_first) as record:
            together = _directory_of_all_parts(run_dir, Path(HydraConfig.get().sweep.dir))
            record["status"], record["error"] = _run(OmegaConf.to_container(cfg, resolve=True), together)  # pyright: ignore[reportArgumentType]
        outcomes.append(record["status"])
        return record["status"]

    return job


def _run(tree: dict[str, Any], run_dir: Path) -> tuple[str, str | None]:
    """Runs the stages. Returns the status and the line that explains it, already printed."""
    try:
        names = pipeline.selected(tree)
        pipeline.meet(tree)
        progress.console.print(f"{', '.join(names)} -> {run_dir}", markup=False)
        pipeline.run(names, pipeline.build_configs(tree), run_dir)
    except (ConfigError, ArtifactError, TrainingDiverged) as error:
        _complain(error)
        return "failed" if isinstance(error, TrainingDiverged) else "bad input", str(error)
    except Exception as error:
        traceback.print_exc()
        return "failed", f"{type(error).__name__}: {error}"
    report = run_dir / "compare" / "report.html"
    progress.console.print(f"done: {report if 'compare' in names and report.exists() else run_dir}", markup=False)
    return "done", None


def _complain(error: Exception) -> int:
    print(" ".join(str(error).split()), file=sys.stderr)
    return 2


# --- the process ------------------------------------------------------------------------------------------------------


def _prepare_process() -> None:
    """What must be set before jax and mujoco are imported, in this process or in a launcher's worker."""
    os.environ["JAX_ENABLE_X64"] = "1"
    os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", "highest")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "qjrl" / f"jax-{_instruction_set()}"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    if sys.platform == "linux" and "MUJOCO_GL" not in os.environ:
        os.environ["MUJOCO_GL"] = _headless_renderer()
    logger = logging.getLogger("qjrl")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [_ConsoleHandler()]


def _instruction_set() -> str:
    """A short name of what this CPU can execute: compiled code must not reach a lesser one through a shared home."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    flags = [line for line in lines if line.startswith(("flags", "Features"))]
    return hash_of(flags[:1] or platform.machine())[:8]


def _headless_renderer() -> str:
    """EGL where its library loads, else OSMesa, else no pictures by MuJoCo."""
    for renderer, library in (("egl", "libEGL.so.1"), ("osmesa", "libOSMesa.so.8"), ("osmesa", "libOSMesa.so")):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return renderer
    return "disable"


class _ConsoleHandler(logging.Handler):
    """Log lines through the console that draws the bars."""

    def emit(self, record: logging.LogRecord) -> None:
        progress.console.print(self.format(record), markup=False)


# --- arguments and Hydra's errors -------------------------------------------------------------------------------------


def _with_robot_files(arguments: list[str], folder: Path) -> list[str]:
    """``robot=my_arm.yaml`` becomes the choice of a copy in a folder that Hydra searches too."""
    shipped = {path.stem for path in (conf_folder() / "robot").glob("*.yaml")}
    copied: dict[str, str] = {}

    def choice(value: str) -> str:
        path = Path(value.strip("'\" ")).expanduser()
        if path.suffix not in (".yaml", ".yml"):
            return value
        read_yaml(path)
        stem = "".join(letter if letter.isalnum() else "_" for letter in path.stem)
        while stem in shipped or copied.get(stem, str(path)) != str(path):
            stem += "_"  # a shipped name would win over the copy
        copied[stem] = str(path)
        (folder / "robot").mkdir(exist_ok=True)
        (folder / "robot" / f"{stem}.yaml").write_bytes(path.read_bytes())
        return stem

    result = []
    for argument in arguments:
        key, _, value = argument.partition("=")
        is_robot = key.lstrip("+") == "robot" and ".y" in value
        result.append(f"{key}={','.join(choice(part) for part in value.split(','))}" if is_robot else argument)
    return [*result, f"hydra.searchpath=['file://{folder}']"] if copied else result


def _readable(error: Exception, arguments: list[str]) -> Exception:
    """Hydra's error as one line in the words of `ConfigError`."""
    from hydra.errors import MissingConfigException
    from omegaconf.errors import OmegaConfBaseException

    if isinstance(error, MissingConfigException) and error.options is not None:
        group, _, choice = (error.missing_cfg_file or "").rpartition("/")
        return ConfigError(f"{group}: got '{choice}', {known_names(choice, error.options)}")
    cause = error.__cause__
    if isinstance(cause, OmegaConfBaseException) and cause.full_key and "not in struct" in str(cause):
        values = [value for key, _, value in (text.partition("=") for text in arguments) if cause.full_key in key]
        known = [key for key in getattr(cause.parent_node, "keys", list)() if key != "hydra"]
        return unknown_key(cause.full_key, values[0] if values else None, known)
    text = str(error).partition("\nSee http")[0]
    override = getattr(error, "override", None)
    return ConfigError(f"{override}: {text}" if override and override not in text else text)


# --- sweeps -----------------------------------------------------------------------------------------------------------


def _pinned_sweep(arguments: list[str]) -> tuple[Path, list[str]]:
    """Where the sweep goes, known before it starts, and overrides that name its jobs by what is swept."""
    from hydra import compose, initialize_config_dir
    from hydra.core.override_parser.overrides_parser import OverridesParser

    texts = [argument for argument in arguments if not argument.startswith("-")]
    overrides = OverridesParser.create().parse_overrides(texts)
    fixed = [override for override in overrides if not override.is_sweep_override()]
    with initialize_config_dir(version_base=None, config_dir=str(conf_folder())):
        composed = compose("config", [str(override.input_line) for override in fixed], return_hydra_config=True)
    keys = ",".join(f"'{override.key_or_group}'" for override in fixed)
    sweep_dir = composed.hydra.sweep.dir
    return Path(sweep_dir), [
        f"hydra.sweep.dir='{sweep_dir}'",
        f"hydra.job.config.override_dirname.exclude_keys=[{keys}]",
    ]


def _directory_of_all_parts(job_dir: Path, sweep_dir: Path) -> Path:
    """The run directory of a job: its own, except that jobs which differ only in their part of a stage share one."""
    if not job_dir.absolute().is_relative_to(sweep_dir.absolute()):
        return job_dir
    names = job_dir.absolute().relative_to(sweep_dir.absolute()).as_posix().split(",")
    kept = [name for name in names if name.partition("=")[0] not in pipeline.PART_KEYS]
    return job_dir if kept == names else sweep_dir / ",".join(kept)


def _finish_sweep(sweep_dir: Path, since: float) -> int:
    """Prints and writes the table over the jobs. Returns the exit code."""
    from rich.markup import escape
    from rich.table import Table

    rows = sweep.gather(sweep_dir, since)
    sweep.write(sweep_dir, rows)
    shown = sweep.headline(rows)
    headers = ["\n".join(key.split(".")[-3:]) for key in shown]
    table = Table("job", "status", "seconds", *headers, title=str(sweep_dir))
    for row in rows:
        errors = [f"{row['metrics'][key]:.3f}" if key in row["metrics"] else "" for key in shown]
        seconds = "" if row["seconds"] is None else f"{row['seconds']:.0f}"
        table.add_row(*(escape(text) for text in (row["job"], row["error"] or row["status"], seconds, *errors)))
    progress.console.print(table)
    return 0 if rows and all(row["status"] == "done" for row in rows) else 1


if __name__ == "__main__":
    from qjrl.__main__ import main as importable_main  # workers of a launcher import the job by name

    sys.exit(importable_main())
