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
from qjrl.report import metrics as measures
from qjrl.report.answers import outcome_of
from qjrl.report.compare.page import Compared, read_measured, run_page
from qjrl.report.outcomes import Outcome
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("build_mjcf",)

    simulation: SettleConfig
    policy: PolicyConfig
    name: str

    def check(self) -> None:
        """The control period holds whole time steps."""
        check_control_period(self.policy.environment, self.simulation.timestep)


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `outcomes.npz` and `report.html`; tables and verdict are shown."""
    del out
    robot, measured = robot_from_mapping(config.robot), read_measured(inputs)
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

    def draw() -> Drawn:
        page = run_page(
            f"{robot.name}, run {config.name}",
            Compared(robot, outcomes, verdict, targets, TARGET_SETS),
            measured,
            artifacts.load(inputs["sample"], robot_hash(robot)),
            {stage: _seconds(path) for stage, path in inputs.items()},
            config.robot["strands"]["pretension"],
        )
        return Drawn(pages={"report": page})

    return Output(
        metrics,
        {"outcomes": _columns(outcomes)},
        draw,
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


def _columns(outcomes: list[Outcome]) -> dict[str, np.ndarray]:
    """Raw errors of every controller, named "SET/CONTROLLER/QUANTITY"."""
    return {
        f"{outcome.target_set}/{outcome.controller}/{quantity}": getattr(outcome, quantity)
        for outcome in outcomes
        for quantity in ("position_error", "orientation_error", "strand_tension")
    }


def _seconds(directory: Path) -> float:
    return artifacts.read_record(directory / artifacts.DONE, {"seconds": int | float}, "a done-marker")["seconds"]


_NEEDED = (
    *TARGET_COLUMNS, "learned_joint_positions", "learned_settled", "predicted_position_error", "learned_position_error"
)  # fmt: skip
_UNTRAINED = "No trained checkpoint beat the base: the residual kept is the untrained one, which equals its base"
