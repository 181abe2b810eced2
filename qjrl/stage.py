"""One stage of a data flow: what it is, and when it runs again.

A stage is a module with a `Config`, which is a `StageConfig`, and ``run(config, inputs, out)``: `inputs` maps the name of
each stage it reads to that stage's directory, `out` is its own. It returns an `Output`, which is written there; what it writes
to `out` itself is what it goes on from when interrupted.

Its output depends on that configuration, on its inputs, its `files` and its `packages`; not on fields that cannot change a
result: those marked `config.NotIdentity`, and the part of a shared stage (`whole`). Output of another identity makes room and
is kept; it is taken back when its identity is asked for again.

Processes can share the work of a stage in one of two ways (`Stage.shared`).
In parts: each process makes a part of the rows, whenever it likes, and needs no other. A part has a directory, a lock and a
done-marker of its own in ``WRITES.parts/PART``; the process that ends last makes the whole of all parts (`run_part`).
Together: all processes run the stage at the same time and exchange what they compute; the first alone writes
(`run_together`).
"""

import dataclasses
import fcntl
import importlib
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from qjrl import artifacts, kept
from qjrl.artifacts import ArtifactError
from qjrl.config import as_mapping, identity_of
from qjrl.machine import MachineError
from qjrl.provenance import provenance, read_provenance
from qjrl.report.output import write_output
from qjrl.stage_config import StageConfig

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
    shared: Literal["alone", "in parts", "together"] = "alone"
    """How processes can share its work; "alone": not at all."""
    part_key: str = ""
    """Key of the configuration that says which part a process makes, of a stage that is shared in parts."""

    @property
    def group(self) -> Literal["pipeline", "tools", "studies"]:
        """Where ``qjrl --help`` shows it: the pipeline, the tools for an arm of one's own, the experiments."""
        if self.default:
            return "pipeline"
        return "studies" if self.module.startswith("qjrl.studies.") else "tools"

    def load(self) -> ModuleType:
        """The stage's module: `Config` and `run`."""
        return importlib.import_module(self.module)


Stages = Mapping[str, Stage]


class AtWork(ArtifactError, MachineError):  # noqa: N818
    """Another process is at work in the same directory."""


@contextmanager
def alone_in(run_dir: Path, name: str = ".lock", wait: bool = False) -> Iterator[None]:
    """Two runs in one directory would move each other's output away."""
    run_dir.mkdir(parents=True, exist_ok=True)
    with open(run_dir / name, "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError as error:
            raise AtWork(f"{run_dir}: another run is at work here; wait for it or choose another name=") from error
        yield


def run_part(stages: Stages, name: str, config: StageConfig, run_dir: Path) -> None:
    """One process's share of a stage; the process that ends last makes the whole of all shares."""
    out = run_dir / stages[name].writes
    whole = _identity(stages, name, config.whole(), run_dir)
    if _is_done(out, whole):
        log.info("%s: done before and unchanged, skipped", name)
        return
    if any(map(_unless_damaged(_is_done, whole), kept.kept_of(out))):
        with alone_in(run_dir, wait=True):
            _take_back(name, out, whole)
        return
    parts = artifacts.parts_of(out)
    with alone_in(parts, f".{config.part}.lock"):
        run_stage(stages, name, config, run_dir)
    every = config.parts().items()
    if all(_is_done(parts / part, _identity(stages, name, other, run_dir)) for part, other in every):
        with alone_in(run_dir, wait=True):  # of two that end at once, the second finds it done
            run_stage(stages, name, config.whole(), run_dir)


def run_together(stages: Stages, name: str, config: StageConfig, run_dir: Path) -> None:
    """A stage that several processes run together: the first as `run_stage` does, the others write nothing."""
    from qjrl.learning import processes

    if not processes.is_first():
        if not processes.of_first(False):
            stages[name].load().run(config, _inputs(stages, name, run_dir), run_dir / stages[name].writes)
        return
    with alone_in(run_dir):
        out, identity = run_dir / stages[name].writes, _identity(stages, name, config, run_dir)
        _take_back(name, out, identity)
        processes.of_first(_is_done(out, identity))
        run_stage(stages, name, config, run_dir)


def run_stage(stages: Stages, name: str, config: StageConfig, run_dir: Path) -> None:
    """Run a stage of a data flow; what is done and unchanged is skipped, what was interrupted goes on."""
    label, out = name, run_dir / stages[name].writes
    identity = _identity(stages, name, config, run_dir)
    if config.part is not None:
        label, out = f"{name} {config.part}", artifacts.parts_of(out) / config.part
    _take_back(label, out, identity)
    if _is_done(out, identity):
        log.info("%s: done before and unchanged, skipped", label)
        return
    _make_room(label, out, identity)
    record = provenance(as_mapping(config), config.seed, identity["robot_hash"])
    artifacts.write_json(out / artifacts.PROVENANCE, record | identity)
    start = time.monotonic()
    write_output(stages[name].load().run(config, _inputs(stages, name, run_dir), out), out)
    artifacts.mark_done(out, **identity, seconds=round(time.monotonic() - start, 1))


def _inputs(stages: Stages, name: str, run_dir: Path) -> dict[str, Path]:
    return {source: run_dir / stages[source].writes for source in stages[name].reads}


def _identity(stages: Stages, name: str, config: StageConfig, run_dir: Path) -> dict[str, Any]:
    """What the output of a stage depends on."""
    robot_hash, inputs = config.robot_hash, _inputs(stages, name, run_dir)
    for directory in inputs.values():
        if artifacts.done_marker(directory) is None:
            state = "is not finished" if directory.exists() else "does not exist"
            needed = [stage for stage in stages if stage in {name, *_unfinished(stages, name, run_dir)}]
            raise ArtifactError(f"{name}: needs {directory}, which {state}; run stages=[{','.join(needed)}]")
    return {
        "config_hash": artifacts.hash_of(identity_of(config) | {**config.files, **config.packages}),
        "robot_hash": robot_hash,
        "inputs": {source: _input_hash(name, source, path, robot_hash) for source, path in inputs.items()},
    }


def _unfinished(stages: Stages, name: str, run_dir: Path) -> set[str]:
    """The stages without which a stage cannot run, and those without which they cannot."""
    missing = {source for source, path in _inputs(stages, name, run_dir).items() if not artifacts.done_marker(path)}
    return missing.union(*(_unfinished(stages, source, run_dir) for source in missing))


def _input_hash(name: str, source: str, directory: Path, robot_hash: str | None) -> str:
    """Identity of a finished input, or one line that says how to get the right one."""
    marker = artifacts.done_marker(directory) or {}
    if robot_hash is not None and marker.get("robot_hash") not in (None, robot_hash):
        raise ArtifactError(f"{name}: {directory} belongs to another robot; run stages=[{source},{name}]")
    return marker["output_hash"]


def _take_back(name: str, out: Path, identity: Mapping[str, Any]) -> None:
    """What is wanted may have made room before: finished, or else begun."""
    if _is_done(out, identity):
        return
    place = kept.take_back(out, _unless_damaged(_is_done, identity))
    if place is None and not _is_begun(out, identity):
        place = kept.take_back(out, _unless_damaged(_is_begun, identity))
    if place is not None:
        log.info("%s: taken back from %s", name, place.name)


def _make_room(name: str, out: Path, identity: Mapping[str, Any]) -> None:
    """An interrupted run of the same identity goes on in its directory; anything else is moved out of the way."""
    if not out.exists() or not any(out.iterdir()):
        log.info("%s: starts", name)
    elif _is_begun(out, identity):
        log.info("%s: was interrupted, goes on", name)
    else:
        place = kept.move_away(out)
        log.info("%s: configuration or inputs changed, starts afresh (the old output is in %s)", name, place.name)
    out.mkdir(parents=True, exist_ok=True)


def _is_done(out: Path, identity: Mapping[str, Any]) -> bool:
    return _holds(artifacts.done_marker(out), identity)


def _is_begun(out: Path, identity: Mapping[str, Any]) -> bool:
    if not (out / artifacts.PROVENANCE).exists() or (out / artifacts.DONE).exists():
        return False
    return _holds(read_provenance(out), identity)


def _holds(record: Mapping[str, Any] | None, identity: Mapping[str, Any]) -> bool:
    return record is not None and all(record.get(key) == value for key, value in identity.items())


def _unless_damaged(
    holds: Callable[[Path, Mapping[str, Any]], bool], identity: Mapping[str, Any]
) -> Callable[[Path], bool]:
    """Of kept output: what is damaged there is no reason to stop."""

    def is_wanted(path: Path) -> bool:
        try:
            return holds(path, identity)
        except ArtifactError:
            return False

    return is_wanted
