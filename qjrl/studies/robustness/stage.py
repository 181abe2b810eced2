"""Stage `robustness`: base, baselines and policy under disturbances that none was made for, on the same held-out targets."""

import dataclasses
from pathlib import Path

from qjrl import progress
from qjrl.control.bases import controller_name
from qjrl.control.policy_training import PolicyConfig, check_control_period
from qjrl.control.target_files import read_targets
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.policy import load_policy
from qjrl.report.answers import outcome_of
from qjrl.report.outcomes import Outcome
from qjrl.report.output import Drawn, Output
from qjrl.robot import robot_from_mapping
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig
from qjrl.studies.robustness.figures import errors_by_disturbance
from qjrl.studies.robustness.measure import RobustnessConfig, disturbances, evaluate_disturbed
from qjrl.studies.robustness.report import robustness_metrics, robustness_table


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("build_mjcf",)

    simulation: SettleConfig
    engine: EngineConfig
    policy: PolicyConfig
    robustness: RobustnessConfig

    def check(self) -> None:
        """The control period holds whole time steps."""
        check_control_period(self.policy.environment, self.physics.timestep)

    @property
    def physics(self) -> SettleConfig | EngineConfig:
        """What evaluates."""
        return self.engine if self.robustness.engine == "training" else self.simulation


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `outcomes.npz`, `table.md` and a figure for every target set; table and verdict are shown."""
    del out
    robot, settings = robot_from_mapping(config.robot), config.robustness
    targets = read_targets(inputs["ik"] / "held_out.npz")
    policy = load_policy(inputs["policy"] / "policy")
    rows = len(disturbances(settings, config.policy.environment)) * len(TARGET_SETS) * settings.num_targets
    controllers = 1 + len({*settings.bases, config.policy.base})
    with progress.track(controllers * rows * config.policy.environment.episode_steps, "disturbing") as advance:
        evaluated = evaluate_disturbed(
            robot, config.physics, config.policy, settings, policy, targets, config.seed, advance
        )
    found = {
        disturbance: [_outcome(*key, *value) for key, value in one.items()] for disturbance, one in evaluated.items()
    }
    names = controller_name(config.policy.base, has_policy=True), controller_name(config.policy.base)
    metrics = robustness_metrics(found, *names)
    columns = {
        f"{disturbance}/{outcome.target_set}/{outcome.controller}/{quantity}": getattr(outcome, quantity)
        for disturbance, outcomes in found.items()
        for outcome in outcomes
        for quantity in ("position_error", "orientation_error")
    }
    return Output(
        metrics,
        {"outcomes": columns},
        lambda: Drawn({target_set: errors_by_disturbance(found, target_set) for target_set in TARGET_SETS}),
        tables={"table": (robustness_table(found, *names),)},
        shown=(metrics["verdict"],),
    )


def _outcome(target_set: str, controller: str, evaluation, left_out: int) -> Outcome:
    evaluated = evaluation.position_error, evaluation.orientation_error, evaluation.strand_tension
    return outcome_of(controller, target_set, *evaluated, left_out)
