"""Stage `compare`: every controller on the same held-out targets, and the report of the run."""

import dataclasses
from pathlib import Path

import numpy as np

from qjrl import artifacts, progress
from qjrl.control.bases import BASES, controller_name
from qjrl.control.comparison import compare_controllers
from qjrl.control.policy_training import PolicyConfig, check_control_period
from qjrl.control.target_files import TARGET_COLUMNS, read_targets
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.policy import load_policy
from qjrl.measured import read_metrics, read_progress
from qjrl.records import NUMBER, Kinds
from qjrl.report import metrics as measures
from qjrl.report.answers import outcome_of
from qjrl.report.compare import sections
from qjrl.report.html import Number
from qjrl.report.outcomes import Outcome, controller_label
from qjrl.report.output import Output
from qjrl.report.page import Report
from qjrl.robot import configuration_from_joint_positions, robot_from_mapping, robot_hash
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig

_ERRORS: Kinds = dict.fromkeys(("median_mm", "p99_mm", "median_deg"), NUMBER)
_FITTED: Kinds = {
    "form": str,
    "best_epoch": int,
    "held_out": _ERRORS,
    "nominal": _ERRORS,
    "rows": {"held_out": int, "fitted": int},
}
_START: Kinds = dict.fromkeys(("uniform_median_mm", "near_home_median_mm"), NUMBER)
_TRAINED: Kinds = {
    **dict.fromkeys(("kept_env_steps", "env_steps", "invalid_steps"), int),
    **dict.fromkeys(("steps_per_second", "physics_steps_per_second", "share_of_physics_rate"), NUMBER),
}


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    policy: PolicyConfig
    name: str

    def check(self) -> None:
        """The control period holds whole time steps."""
        check_control_period(self.policy.environment, self.simulation.timestep)


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `outcomes.npz` and `report.html`; tables and verdict are shown."""
    del out
    robot, measured = robot_from_mapping(config.robot), _measured(inputs)
    targets = read_targets(inputs["ik"] / "held_out.npz", _NEEDED)
    policy = load_policy(inputs["policy"] / "policy")
    total = (len(BASES) + 1) * len(targets["target"]) * config.policy.environment.episode_steps
    with progress.track(total, "comparing controllers") as advance:
        evaluated = compare_controllers(robot, config.simulation, config.policy, policy, targets, config.seed, advance)
    outcomes = [
        outcome_of(name, target_set, one.position_error, one.orientation_error, one.strand_tension, left_out)
        for (target_set, name), (one, left_out) in evaluated.items()
    ]
    verdict = _verdict(config, outcomes, measured.trained)
    metrics = {
        "headline": verdict.headline,
        "ratios": verdict.ratios,
        "ratio_intervals": verdict.intervals,
        "controllers": measures.metrics_of(outcomes),
    }
    return Output(
        metrics,
        {"outcomes": _columns(outcomes)},
        pages={"report": _report(config, robot, inputs, outcomes, targets, measured)},
        shown=(
            measures.error_table(outcomes),
            measures.tension_table(outcomes),
            f"{verdict.headline}. {verdict.detail}",
        ),
    )


def _verdict(config: Config, outcomes: list[Outcome], trained: dict) -> measures.Verdict:
    """The verdict in words; a policy that is its own base, untrained, is not praised for being as good.

    One that started as noise is no base of its own: the verdict on it stands.
    """
    verdict = measures.evaluate_residual(
        outcomes, controller_name(config.policy.base, has_policy=True), controller_name(config.policy.base)
    )
    if trained["kept_env_steps"] > 0 or "base" not in trained:
        return verdict
    return dataclasses.replace(verdict, holds=None, headline=_UNTRAINED)


@dataclasses.dataclass(frozen=True)
class _Measured:
    """What the stages before this one measured."""

    fitted: dict
    inverted: dict
    trained: dict
    """With the errors before any training under "base" or "untrained"."""
    fit: list[dict]
    training: list[dict]


def _measured(inputs: dict[str, Path]) -> _Measured:
    trained = read_metrics(inputs["policy"] / "metrics.json", _TRAINED)
    start = "base" if "base" in trained else "untrained"
    return _Measured(
        read_metrics(inputs["forward_model"] / "metrics.json", _FITTED),
        read_metrics(inputs["ik"] / "metrics.json", {"targets_per_second": NUMBER}),
        read_metrics(inputs["policy"] / "metrics.json", {**_TRAINED, start: _START}),
        read_progress(inputs["forward_model"] / "progress.jsonl", "epoch"),
        read_progress(inputs["policy"] / "progress.jsonl", "env_steps"),
    )


def _columns(outcomes: list[Outcome]) -> dict[str, np.ndarray]:
    """Raw errors of every controller, named "SET/CONTROLLER/QUANTITY"."""
    return {
        f"{outcome.target_set}/{outcome.controller}/{quantity}": getattr(outcome, quantity)
        for outcome in outcomes
        for quantity in ("position_error", "orientation_error", "strand_tension")
    }


def _report(
    config: Config,
    robot: Robot,
    inputs: dict[str, Path],
    outcomes: list[Outcome],
    targets,
    measured: _Measured,
) -> Report:
    data = artifacts.load(inputs["sample"], robot_hash(robot))
    verdict = _verdict(config, outcomes, measured.trained)
    unsettled = int(np.sum(~data["converged"]))
    return Report(
        title=f"{robot.name}, run {config.name}",
        headline=verdict.headline,
        detail=verdict.detail,
        holds=verdict.holds,
        summary=_summary(outcomes, measured.fitted, measured.trained),
        warnings=sections.warnings_of(outcomes, len(data["seed"]), unsettled),
        sections=(
            sections.results_section(outcomes, _RESULTS_TEXT, config.robot["strands"]["pretension"]),
            _arm_section(robot, targets),
            sections.sample_section(robot, data),
            sections.forward_model_section(measured.fitted, measured.fit),
            sections.ik_section(targets, measured.inverted, TARGET_SETS),
            _policy_section(measured.training, measured.trained),
        ),
        durations={stage: _seconds(path) for stage, path in inputs.items()},
    )


def _seconds(directory: Path) -> float:
    return artifacts.read_record(directory / artifacts.DONE, {"seconds": int | float}, "a done-marker")["seconds"]


def _summary(outcomes: list[Outcome], fitted: dict, trained: dict) -> tuple[Number, ...]:
    headline_set = TARGET_SETS[0]
    medians = {
        one.controller: float(np.median(one.position_error_mm)) for one in outcomes if one.target_set == headline_set
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


def _arm_section(robot: Robot, targets):
    rows = np.flatnonzero(targets["target_set"] == 0)[:3]
    positions = targets["learned_joint_positions"][rows]
    bends = np.stack([configuration_from_joint_positions(robot, row) for row in positions])
    return sections.arm_section(robot, bends, targets["target"][rows], positions[0])


def _policy_section(records: list[dict], trained: dict):
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


_NEEDED = (
    *TARGET_COLUMNS, "learned_joint_positions", "learned_settled", "predicted_position_error", "learned_position_error"
)  # fmt: skip
_UNTRAINED = "No trained checkpoint beat the base: the residual kept is the untrained one, which equals its base"
_RESULTS_TEXT = (
    "One episode of four seconds a target, from home: strand friction, damping, inertia, gains and the base's tilt are "
    "drawn anew for every target, and are the same for every controller. Errors are means over the last half second."
)
