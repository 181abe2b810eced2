"""The data flow on one page: which stages there are, what each reads and writes.

    sample ──> forward_model ──> ik ──> policy ──> compare

What a stage is, and when one runs again: `stage`.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

from qjrl import machine
from qjrl.config import ConfigError, Range, build, configuration, known_names, unknown_key
from qjrl.field_words import show
from qjrl.stage import Stage, alone_in, run_part, run_stage, run_together
from qjrl.stage_config import StageConfig

STAGES: dict[str, Stage] = {
    "sample": Stage(
        "qjrl.stages.sample",
        "settle cable commands in MuJoCo and write the data set",
        writes="dataset",
        shared="in parts",
        part_key="sample.shard",
    ),
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
        shared="together",
    ),
    "compare": Stage(
        "qjrl.stages.compare",
        "measure every controller on the same targets, write the report",
        reads=("sample", "forward_model", "ik", "policy"),
        writes="compare",
    ),
    "robustness": Stage(
        "qjrl.studies.robustness.stage",
        "evaluate base, baselines and policy under disturbances",
        reads=("ik", "policy"),
        writes="robustness",
        default=False,
    ),
    "residual": Stage(
        "qjrl.studies.residual.stage",
        "find what the policy does over time, what makes its base err, and what in its training matters",
        reads=("ik", "policy"),
        writes="residual",
        default=False,
    ),
    "open_loop": Stage(
        "qjrl.studies.open_loop.stage",
        "settle FABRIK's, least squares' and the learned IK's commands",
        reads=("forward_model",),
        writes="open_loop",
        default=False,
    ),
    "model_study": Stage("qjrl.studies.model_study.stage", "compare forward models", ("sample",), "model_study", False),
    "export": Stage(
        "qjrl.stages.export",
        "write forward model and inverse kinematics as files that run without qjrl",
        reads=("sample", "forward_model"),
        writes="export",
        default=False,
    ),
    "deploy": Stage("qjrl.stages.deploy", "run the controller in real time", ("ik", "policy"), "deploy", False),
    "accuracy": Stage(
        "qjrl.studies.accuracy.stage",
        "evaluate every controller open loop and with pose measurements",
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
        "qjrl.studies.workspace.stage",
        "measure and compare what the tips of arms reach",
        writes="workspace",
        default=False,
    ),
    "elliptical_deviation": Stage(
        "qjrl.studies.elliptical_deviation.stage",
        "measure how far the joint's path leaves the circle, and what it does to the arm",
        writes="elliptical_deviation",
        default=False,
    ),
    "jitter": Stage(
        "qjrl.studies.jitter.stage", "measure what moves at rest, in C and MJX", writes="jitter", default=False
    ),
    "table3": Stage(
        "qjrl.studies.table3.stage",
        "solve the paper's inverse-kinematics protocol by FABRIK and least squares",
        writes="table3",
        default=False,
    ),
}


GROUPS = {"simulation": "sample", "engine": "policy", **{name: name for name in STAGES if name != "compare"}}
"""Key of the configuration that holds settings -> a stage that has it, whose Config says of what kind they are."""


ROBOT = "robot"
"""The key that holds the description of a robot; its file names the kind."""


PART_KEYS = tuple(stage.part_key for stage in STAGES.values() if stage.shared == "in parts")
"""Keys that say which part of a stage a process makes: a sweep over them fills one run directory."""


TOGETHER = tuple(name for name, stage in STAGES.items() if stage.shared == "together")
"""Stages that several processes can run together."""


@configuration
class ProcessesConfig:
    """Processes, on as many machines, that run one stage together by JAX's distributed runtime."""

    count: Annotated[int, Range(1, 100_000)] = 1
    index: Annotated[int, Range(0, 100_000)] = 0
    """Number of this one, from 0. The first alone writes; all read the stage's inputs."""
    coordinator: str = ""
    """HOST:PORT, on the first one's machine, at which they meet."""
    patience: Annotated[float, Range(above=0.0, high=86_400.0)] = 60.0
    """Longest wait for the others at the start [s]."""

    def __post_init__(self) -> None:
        if self.index >= self.count:
            raise ValueError(f"index: got {self.index}, allowed: 0 to {self.count - 1}, below count")
        host, _, port = self.coordinator.rpartition(":")
        if self.count > 1 and not (host and port.isdecimal() and port.isascii() and 0 < int(port[:6]) < 65_536):
            raise ValueError(f"coordinator: got '{self.coordinator}', allowed: HOST:PORT, for a count of {self.count}")


@configuration
class RunConfig:
    """The top-level keys that belong to the run and to no stage."""

    name: str = "default"
    """Name of the directory of the run."""
    stages: tuple[str, ...] = dataclasses.field(
        default_factory=lambda: tuple(name for name, stage in STAGES.items() if stage.default)
    )
    """Names of the stages to run, in any order."""
    seed: Annotated[int, Range(0, 2**32 - 1)] = 0
    """Of everything random, in every stage."""
    processes: ProcessesConfig = ProcessesConfig()

    def __post_init__(self) -> None:
        check_name(self.name)
        if not self.stages:
            raise ConfigError(f"stages: got [], allowed: some of {', '.join(STAGES)}")
        for stage in self.stages:
            if stage not in STAGES:
                raise ConfigError(f"stages: got '{stage}', {known_names(stage, STAGES)}")
        if self.processes.count > 1 and (len(self.stages) != 1 or self.stages[0] not in TOGETHER):
            allowed = " or ".join(f"[{name}]" for name in TOGETHER)
            raise ConfigError(f"stages: got [{','.join(self.stages)}], allowed: {allowed} alone, by several processes")


def check_name(name: Any) -> str:
    """The name of a run, if it can be that of a directory below the one of all runs.

    Raises:
        ConfigError: it is empty, no text, or leads somewhere else.
    """
    parts = name.split("/") if isinstance(name, str) else [""]
    is_fine = all(
        part.strip() and part not in (".", "..") and len(part.encode(errors="replace")) < 240 for part in parts
    )
    if not is_fine or not name.isprintable():
        raise ConfigError(
            f"name: got {show(name)}, allowed: the name of a directory, below 240 bytes, or of one below another as in a/b"
        )
    return name


def selected(tree: Mapping[str, Any]) -> list[str]:
    """The stages that a configuration asks for, each once, in the order of the data flow."""
    return in_order(build(RunConfig, _part(tree, RunConfig)).stages)


def meet(tree: Mapping[str, Any]) -> None:
    """Joins the other processes of the run, if there are any, before JAX looks for devices; then there must be some.

    Raises:
        MachineError: the others are not there, or there is no device.
    """
    config = build(RunConfig, _part(tree, RunConfig)).processes
    if config.count > 1:
        from qjrl.learning import processes

        processes.join(config.coordinator, config.count, config.index, config.patience)
    machine.require_device()


def in_order(names: Iterable[str]) -> list[str]:
    """The stages named, each once, in the order of the data flow."""
    return [name for name in STAGES if name in set(names)]


def run(names: Iterable[str], configs: Mapping[str, StageConfig], run_dir: Path) -> None:
    """Runs the stages asked for in the order of the data flow; what is done and unchanged is skipped.

    Args:
        names: stages to run.
        configs: stage name -> its Config, from `build_configs`.
        run_dir: where the stages' directories are or will be.
    """
    ordered = in_order(names)
    in_parts = [name for name in ordered if configs[name].part is not None]
    if in_parts:
        if ordered != in_parts:
            only = configs[in_parts[0]].part
            raise ConfigError(
                f"stages: got [{','.join(ordered)}], allowed: [{in_parts[0]}] alone to make part {only} of it"
            )
        return run_part(STAGES, in_parts[0], configs[in_parts[0]], run_dir)
    from qjrl.learning import processes

    if processes.are_several():
        return run_together(STAGES, ordered[0], configs[ordered[0]], run_dir)
    with alone_in(run_dir):
        for name in ordered:
            run_stage(STAGES, name, configs[name].whole(), run_dir)


def build_configs(tree: Mapping[str, Any], names: Iterable[str] | None = None) -> dict[str, Any]:
    """Checks the whole configuration before any work, and builds the Configs of some stages.

    What is misspelt or out of range anywhere is refused, first what the tree says of a group: only that stage's module is
    imported for it. A stage that cannot be imported here stops only those who ask for it or for values of its own. What a
    stage itself refuses (its `check`, the files that it reads) stops no other.

    Args:
        tree: the resolved configuration as plain dicts and lists; what is missing has its default.
        names: of the stages that are to run, all by default.
    Raises:
        ConfigError: at the first value that is not allowed and at a top-level key that nothing knows.
    """
    known = {*(field.name for field in dataclasses.fields(RunConfig)), *GROUPS, ROBOT}
    for key in tree:
        if key not in known:
            raise unknown_key(key, tree[key], sorted(known))
    for group in GROUPS:
        if tree.get(group, {}) != {}:
            build(kind_of(group), tree[group], group)
    kinds = {name: STAGES[name].load().Config for name in in_order(STAGES if names is None else names)}
    configs = {name: build(kind, _part(tree, kind)) for name, kind in kinds.items()}
    if ROBOT in tree:
        from qjrl.robot import robot_from_mapping

        robot_from_mapping(tree[ROBOT])
    for name, config in configs.items():
        _ = config.robot_hash  # raises for a robot that no stage can work on
        if (need := config.lacks) is not None:
            able = [other for other in configs if configs[other].lacks is None]
            kind = tree[ROBOT]["kind"]
            raise ConfigError(
                f"robot: got the kind {kind}, which offers no {need}, allowed: one that does, for stage {name}"
                f"{'; run stages=[' + ','.join(able) + ']' if able else ''}"
            )
        config.check()
    return configs


def kind_of(group: str) -> Any:
    """The class of the settings of a group, or the union of several; built of nothing it is what is run when nothing is said.
    Imports a stage."""
    return next(field.type for field in dataclasses.fields(STAGES[GROUPS[group]].load().Config) if field.name == group)


def _part(tree: Mapping[str, Any], kind: type) -> dict[str, Any]:
    return {field.name: tree[field.name] for field in dataclasses.fields(kind) if field.name in tree}
