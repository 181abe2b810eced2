"""The data flow on one page: which stages there are, what each reads and writes, and when one runs again.

    sample ──> forward_model ──> ik ──> policy ──> compare

A stage is a module with a frozen dataclass `Config`, whose fields are top-level keys of the configuration, and
``run(config, inputs, out)``: `inputs` maps the name of each stage it reads to that stage's directory, `out` is its own.

Many processes may share the work of a stage whose `Config` has `part` (the name of this process's part, None for all),
`parts()` (name -> Config of every part) and `whole()` (the Config of all of it, the same for every part). Each part has
a directory, a lock and a done-marker of its own in ``WRITES.parts/PART``; the whole is made of them when all are there.
"""

import dataclasses
import fcntl
import importlib
import logging
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, as_mapping, build, known_names, unknown_key
from qjrl.provenance import provenance

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Stage:
    """One step of the data flow; its module is imported when it is first needed."""

    module: str
    summary: str
    """What it does, for ``qjrl --help``."""
    reads: tuple[str, ...] = ()
    """Names of the stages whose directories it reads."""
    writes: str = ""
    """Name of its directory under the run directory."""
    default: bool = True
    """Whether it runs when no stages are asked for."""

    def load(self) -> ModuleType:
        """The stage's module: `Config` and `run`."""
        return importlib.import_module(self.module)


STAGES: dict[str, Stage] = {
    "sample": Stage("qjrl.stages.sample", "settle cable commands in MuJoCo and write the data set", writes="dataset"),
    "forward_model": Stage(
        "qjrl.stages.forward_model",
        "fit cable lengths -> pose on the data set",
        reads=("sample",),
        writes="forward_model",
    ),
    "ik": Stage(
        "qjrl.stages.ik",
        "invert the model, settle every answer, write the target bank",
        reads=("forward_model",),
        writes="ik",
    ),
    "policy": Stage(
        "qjrl.stages.policy",
        "train the residual policy on the target bank with PPO",
        reads=("forward_model", "ik"),
        writes="policy",
    ),
    "compare": Stage(
        "qjrl.stages.compare",
        "measure every controller on the same targets, write the report",
        reads=("sample", "forward_model", "ik", "policy"),
        writes="compare",
    ),
    "open_loop": Stage(
        "qjrl.stages.open_loop",
        "settle FABRIK's, least squares' and the learned IK's commands",
        reads=("forward_model",),
        writes="open_loop",
        default=False,
    ),
    "model_study": Stage("qjrl.stages.model_study", "compare forward models", ("sample",), "model_study", False),
    "export": Stage(
        "qjrl.stages.export",
        "write forward model and inverse kinematics as files that run without qjrl",
        reads=("sample", "forward_model"),
        writes="export",
        default=False,
    ),
    "accuracy": Stage(
        "qjrl.stages.accuracy",
        "judge every controller open loop and with pose measurements",
        reads=("sample", "forward_model"),
        writes="accuracy",
        default=False,
    ),
    "describe": Stage(
        "qjrl.stages.describe",
        "say what an arm is: strokes, tensions, reach, a picture",
        writes="describe",
        default=False,
    ),
    "pretension": Stage("qjrl.stages.pretension", "find the least pretension", writes="pretension", default=False),
    "track": Stage("qjrl.stages.track", "follow a path of poses in the physics", ("forward_model",), "track", False),
    "workspace": Stage(
        "qjrl.stages.workspace", "measure and compare what the tips of arms reach", writes="workspace", default=False
    ),
    "elliptical_deviation": Stage(
        "qjrl.stages.elliptical_deviation",
        "measure how far the joint's path leaves the circle, and what it does to the arm",
        writes="elliptical_deviation",
        default=False,
    ),
    "table3": Stage(
        "qjrl.stages.table3",
        "solve the paper's inverse-kinematics protocol by FABRIK and least squares",
        writes="table3",
        default=False,
    ),
}


PART_KEYS = ("sample.shard",)
"""Keys that say which part of a stage a process makes: a sweep over them fills one run directory."""


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """The top-level keys that belong to the run and to no stage."""

    name: str
    """Name of the directory of the run."""
    stages: tuple[str, ...]
    """Names of the stages to run, in any order."""

    def __post_init__(self) -> None:
        if not self.stages:
            raise ConfigError(f"stages: got [], allowed: some of {', '.join(STAGES)}")
        for stage in self.stages:
            if stage not in STAGES:
                raise ConfigError(f"stages: got '{stage}', {known_names(stage, STAGES)}")


def selected(tree: Mapping[str, Any]) -> list[str]:
    """The stages that a configuration asks for, each once, in the order of the data flow."""
    return in_order(build(RunConfig, _part(tree, RunConfig)).stages)


def in_order(names: Iterable[str]) -> list[str]:
    """The stages named, each once, in the order of the data flow."""
    return [name for name in STAGES if name in set(names)]


def run(names: Iterable[str], configs: Mapping[str, Any], run_dir: Path) -> None:
    """Runs the stages asked for in the order of the data flow; what is done and unchanged is skipped.

    Args:
        names: stages to run.
        configs: stage name -> its Config, from `build_configs`.
        run_dir: where the stages' directories are or will be.
    """
    ordered = in_order(names)
    shared = [name for name in ordered if getattr(configs[name], "part", None) is not None]
    if shared:
        return _run_part(shared[0], configs[shared[0]], ordered, run_dir)
    with _alone_in(run_dir):
        for name in ordered:
            config = configs[name]
            _run_stage(name, config.whole() if hasattr(config, "whole") else config, run_dir)


def build_configs(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Checks the whole configuration before any work: builds every stage's Config from the keys it names.

    Args:
        tree: the resolved configuration as plain dicts and lists.
    Raises:
        ConfigError: at the first value that is not allowed and at a top-level key that no stage knows.
    """
    kinds = {name: stage.load().Config for name, stage in STAGES.items()}
    known = {field.name for kind in (RunConfig, *kinds.values()) for field in dataclasses.fields(kind)}
    for key in tree:
        if key not in known:
            raise unknown_key(key, tree[key], sorted(known))
    configs = {name: build(kind, _part(tree, kind)) for name, kind in kinds.items()}
    for config in configs.values():
        _robot_hash(config)
    return configs


@contextmanager
def _alone_in(run_dir: Path, name: str = ".lock", wait: bool = False) -> Iterator[None]:
    """Two runs in one directory would move each other's output away."""
    run_dir.mkdir(parents=True, exist_ok=True)
    with open(run_dir / name, "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError as error:
            raise ArtifactError(
                f"{run_dir}: another run is at work here; wait for it or choose another name="
            ) from error
        yield


def _part(tree: Mapping[str, Any], kind: type) -> dict[str, Any]:
    return {field.name: tree[field.name] for field in dataclasses.fields(kind) if field.name in tree}


def _run_part(name: str, config: Any, stages: list[str], run_dir: Path) -> None:
    """One process's share of a stage; the process that ends last makes the whole of all shares."""
    if stages != [name]:
        raise ConfigError(f"stages: got [{','.join(stages)}], allowed: [{name}] alone to make part {config.part} of it")
    out = run_dir / STAGES[name].writes
    if _same(out / artifacts.DONE, _identity(name, config.whole(), run_dir)):
        log.info("%s: done before and unchanged, skipped", name)
        return
    parts = artifacts.parts_of(out)
    with _alone_in(parts, f".{config.part}.lock"):
        _run_stage(name, config, run_dir)
    every = config.parts().items()
    if all(_same(parts / part / artifacts.DONE, _identity(name, other, run_dir)) for part, other in every):
        with _alone_in(run_dir, wait=True):  # of two that end at once, the second finds it done
            _run_stage(name, config.whole(), run_dir)


def _run_stage(name: str, config: Any, run_dir: Path) -> None:
    stage, out = STAGES[name], run_dir / STAGES[name].writes
    part, robot_hash = getattr(config, "part", None), _robot_hash(config)
    identity = _identity(name, config, run_dir)
    if part is not None:
        name, out = f"{name} {part}", artifacts.parts_of(out) / part
    if _same(out / artifacts.DONE, identity):
        log.info("%s: done before and unchanged, skipped", name)
        return
    _make_room(name, out, identity)
    record = provenance(as_mapping(config), getattr(config, "seed", None), robot_hash)
    artifacts.write_json(out / artifacts.PROVENANCE, record | identity)
    start = time.monotonic()
    stage.load().run(config, _inputs(stage, run_dir), out)
    artifacts.mark_done(out, **identity, seconds=round(time.monotonic() - start, 1))


def _inputs(stage: Stage, run_dir: Path) -> dict[str, Path]:
    return {source: run_dir / STAGES[source].writes for source in stage.reads}


def _identity(name: str, config: Any, run_dir: Path) -> dict[str, Any]:
    """What the output of a stage depends on."""
    robot_hash, inputs = _robot_hash(config), _inputs(STAGES[name], run_dir)
    return {
        "config_hash": artifacts.hash_of(as_mapping(config) | getattr(config, "files", {})),
        "robot_hash": robot_hash,
        "inputs": {source: _input_hash(name, source, path, robot_hash) for source, path in inputs.items()},
    }


def _input_hash(name: str, source: str, directory: Path, robot_hash: str | None) -> str:
    """Identity of a finished input, or one line that says how to get it."""
    marker = artifacts.done_marker(directory)
    if marker is None:
        state = "is not finished" if directory.exists() else "does not exist"
        raise ArtifactError(f"{name}: needs {directory}, which {state}; run stages=[{source},{name}]")
    if robot_hash is not None and marker.get("robot_hash") not in (None, robot_hash):
        raise ArtifactError(f"{name}: {directory} belongs to another robot; run stages=[{source},{name}]")
    return marker["output_hash"]


def _make_room(name: str, out: Path, identity: Mapping[str, Any]) -> None:
    """An interrupted run of the same identity goes on in its directory; anything else is moved out of the way."""
    if not out.exists() or not any(out.iterdir()):
        log.info("%s: starts", name)
    elif _same(out / artifacts.PROVENANCE, identity) and not (out / artifacts.DONE).exists():
        log.info("%s: was interrupted, goes on", name)
    else:
        previous = out.with_name(out.name + ".previous")
        shutil.rmtree(previous, ignore_errors=True)
        out.rename(previous)
        log.info("%s: configuration or inputs changed, starts afresh (the old output is in %s)", name, previous.name)
    out.mkdir(parents=True, exist_ok=True)


def _same(record: Path, identity: Mapping[str, Any]) -> bool:
    if not record.exists():
        return False
    content = artifacts.load(record)
    return all(content.get(key) == value for key, value in identity.items())


def _robot_hash(config: Any) -> str | None:
    """Of the robot a stage works on; a stage that names its robots itself says what they are by `robot_hash`."""
    if hasattr(config, "robot_hash"):
        return config.robot_hash
    if not hasattr(config, "robot"):
        return None
    from qjrl.robot import robot_from_mapping, robot_hash

    return robot_hash(robot_from_mapping(config.robot))
