"""The page of a run: the verdict, every controller, and what each stage before measured."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qjrl.measured import read_metrics, read_progress
from qjrl.records import NUMBER, Kinds
from qjrl.report.compare import sections
from qjrl.report.html import Number
from qjrl.report.metrics import Verdict
from qjrl.report.outcomes import Outcome, controller_label
from qjrl.report.page import Report, Section
from qjrl.robot import configuration_from_joint_positions
from qjrl.robot.model_kinds import MODEL_KINDS
from qjrl.robot.verbs import Robot

_ERRORS: Kinds = dict.fromkeys(("median_mm", "p99_mm", "median_deg"), NUMBER)
_FITTED: Kinds = {
    "held_out": _ERRORS,
    "nominal": _ERRORS,
    "rows": {"held_out": int, "fitted": int},
}
_FITTED_IN_EPOCHS: Kinds = {"form": str, "best_epoch": int, **_FITTED}
_START: Kinds = dict.fromkeys(("uniform_median_mm", "near_home_median_mm"), NUMBER)
_TRAINED: Kinds = {
    **dict.fromkeys(("kept_env_steps", "env_steps", "invalid_steps"), int),
    **dict.fromkeys(("steps_per_second", "physics_steps_per_second", "share_of_physics_rate"), NUMBER),
}
_RESULTS_TEXT = (
    "One episode of four seconds a target, from home: strand friction, damping, inertia, gains and the base's tilt are "
    "drawn anew for every target, and are the same for every controller. Errors are means over the last half second."
)


@dataclasses.dataclass(frozen=True)
class Measured:
    """What the stages before this one measured."""

    fitted: dict
    inverted: dict
    trained: dict
    """With the errors before any training under "base" or "untrained"."""
    fit: list[dict]
    training: list[dict]


def read_measured(inputs: Mapping[str, Path]) -> Measured:
    """What the metrics and logs of the stages hold.

    Raises:
        ArtifactError: a file is missing, damaged, or lacks a number.
    """
    model, has_log = inputs["forward_model"], _has_log(inputs["forward_model"] / "metrics.json")
    trained = read_metrics(inputs["policy"] / "metrics.json", _TRAINED)
    start = "base" if "base" in trained else "untrained"
    return Measured(
        read_metrics(model / "metrics.json", _FITTED_IN_EPOCHS if has_log else _FITTED),
        read_metrics(inputs["ik"] / "metrics.json", {"targets_per_second": NUMBER}),
        read_metrics(inputs["policy"] / "metrics.json", {**_TRAINED, start: _START}),
        read_progress(model / "progress.jsonl", "epoch") if has_log else [],
        read_progress(inputs["policy"] / "progress.jsonl", "env_steps"),
    )


def _has_log(metrics: Path) -> bool:
    """Whether the model is of a kind that logs its fit; metrics that name no kind are of the default one."""
    kind = MODEL_KINDS.get(str(read_metrics(metrics, {}).get("kind", next(iter(MODEL_KINDS)))))
    return kind is not None and kind.has_log


@dataclasses.dataclass(frozen=True)
class Compared:
    """What the comparison found."""

    robot: Robot
    outcomes: Sequence[Outcome]
    verdict: Verdict
    targets: Mapping[str, np.ndarray]
    """Columns of the held-out targets and their answers."""
    target_sets: Sequence[str]
    """Their names, the headline first."""


def run_page(
    title: str,
    compared: Compared,
    measured: Measured,
    data: Mapping[str, np.ndarray],
    durations: Mapping[str, float],
    pretension: float,
) -> Report:
    """The page.

    Args:
        data: columns of the data set.
        durations: stage -> seconds.
        pretension: of the strands at home [N].
    """
    verdict, outcomes, targets = compared.verdict, compared.outcomes, compared.targets
    unsettled = int(np.sum(~data["converged"]))
    return Report(
        title=title,
        headline=verdict.headline,
        detail=verdict.detail,
        holds=verdict.holds,
        summary=_summary(compared, measured.fitted, measured.trained),
        warnings=sections.warnings_of(outcomes, len(data["seed"]), unsettled),
        sections=(
            sections.results_section(outcomes, _RESULTS_TEXT, pretension),
            _arm_section(compared.robot, targets),
            sections.sample_section(compared.robot, data),
            sections.forward_model_section(measured.fitted, measured.fit),
            sections.ik_section(targets, measured.inverted, compared.target_sets),
            policy_section(measured.training, measured.trained),
        ),
        durations=durations,
    )


def _summary(compared: Compared, fitted: dict, trained: dict) -> tuple[Number, ...]:
    headline_set = compared.target_sets[0]
    medians = {
        one.controller: float(np.median(one.position_error_mm))
        for one in compared.outcomes
        if one.target_set == headline_set
    }
    return (
        *(Number(controller_label(name), value, "mm", "median, randomised physics") for name, value in medians.items()),
        Number("forward model", fitted["held_out"]["median_mm"], "mm", "held-out median"),
        Number(
            "training rate",
            trained["steps_per_second"],
            "steps/s",
            f"{100 * trained['share_of_physics_rate']:.0f} % of the physics alone",
        ),
    )


def _arm_section(robot: Robot, targets: Mapping[str, np.ndarray]) -> Section:
    rows = np.flatnonzero(targets["target_set"] == 0)[:3]
    positions = targets["learned_joint_positions"][rows]
    configurations = np.stack([configuration_from_joint_positions(robot, row) for row in positions])
    return sections.arm_section(robot, configurations, targets["target"][rows], positions[0])


def policy_section(records: list[dict], trained: dict[str, Any]) -> Section:
    """What the training did, with the errors before it."""
    numbers = (
        Number("environment steps", trained["env_steps"]),
        Number(
            "rate",
            trained["steps_per_second"],
            "steps/s",
            f"the physics alone: {trained['physics_steps_per_second']:.0f}",
        ),
        Number("diverged steps", trained["invalid_steps"]),
    )
    name, start = ("base", trained["base"]) if "base" in trained else ("untrained policy", trained["untrained"])
    return sections.policy_section(
        records,
        {"evaluation/uniform_median_mm": "uniform bends", "evaluation/near_home_median_mm": "near home"},
        {
            f"{name}, uniform bends": start["uniform_median_mm"],
            f"{name}, near home": start["near_home_median_mm"],
        },
        numbers,
        "Evaluated on targets set apart from the bank, randomised arms; the best of the checkpoints is kept: "
        f"the one after {trained['kept_env_steps']:,} steps.",
    )
