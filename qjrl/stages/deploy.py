"""Stage `deploy`: the controller with its policy as files, run in real time against C MuJoCo, recorded and replayed."""

import dataclasses
from contextlib import ExitStack
from pathlib import Path

import jax
import numpy as np

from qjrl import artifacts, progress
from qjrl.config import ConfigError, as_mapping
from qjrl.control.bases import command_column, environment_of
from qjrl.control.deployable import ControllerFunctions, checked_policy, controller_functions
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.evaluation import arrives_in_time
from qjrl.control.policy_training import PolicyConfig, check_control_period
from qjrl.control.simulated_arm import SimulatedArm, rehearse
from qjrl.control.target_files import read_targets
from qjrl.deployment import onnx_model
from qjrl.deployment.controller import deployed_controller
from qjrl.deployment.controller_export import ControllerExport, controller_contract, export_files
from qjrl.deployment.controller_parity import Rehearsal
from qjrl.deployment.deploy import DeployConfig, deploy
from qjrl.deployment.real_time import Schedule
from qjrl.deployment.recording import Record, as_record, flagged, load_record, replay, timing
from qjrl.deployment.safety import ASKED, SafeController, reading_limits
from qjrl.geometry.pose import row_errors
from qjrl.learning.ppo.policy import Policy, load_policy
from qjrl.provenance import read_provenance
from qjrl.report.deploy.figures import errors_over_time, latency_histogram
from qjrl.report.deploy.report import deployment_report, episode_table, headline, target_mark
from qjrl.report.output import Drawn, Output
from qjrl.report.track.viewer import track_viewer
from qjrl.robot import in_precision, robot_from_mapping, robot_hash
from qjrl.robot.verbs import Robot
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("build_mjcf", "interface")

    simulation: SettleConfig
    policy: PolicyConfig
    deploy: DeployConfig

    def check(self) -> None:
        """The control period holds whole time steps."""
        check_control_period(self.policy.environment, self.simulation.timestep)
        replay = self.deploy.replay
        if replay and not Path(replay).is_file():
            raise ConfigError(f"deploy.replay: {replay} does not exist; give the log.npz of a deployment")

    @property
    def files(self) -> dict[str, str]:
        """The record that is replayed, and its hash."""
        path = Path(self.deploy.replay)
        return {str(path): artifacts.hash_of_file(path)} if self.deploy.replay else {}

    @property
    def packages(self) -> dict[str, str]:
        """Once the extra is installed, the same command writes what is missing."""
        return onnx_model.missing_for(self.deploy.files.onnx)


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """The files, `contract.json`, `log.npz`, `metrics.json`, figures and `deploy.html`; or nothing if a check fails."""
    robot, settings = robot_from_mapping(config.robot), config.deploy
    recorded = load_record(_where(settings.replay, out), robot_hash(robot)) if settings.replay else None
    environment = environment_of(config.policy.environment, config.policy.base)
    policy = checked_policy(environment.controller, robot, load_policy(inputs["policy"] / "policy"))
    columns = ("target", command_column(config.policy.base))
    held_out = read_targets(inputs["ik"] / "held_out.npz", columns)
    targets = _targets(config, robot, held_out)
    arm = SimulatedArm(robot, environment.randomisation, config.simulation.timestep, config.seed)
    export = _export(config, robot, environment, policy, arm, targets)
    about = as_mapping(environment.controller) | {"base": config.policy.base, "largest_age": settings.largest_age}
    contract = controller_contract(export, robot, settings.files, about, read_provenance(out))
    files = export.controllers["control_step.stablehlo"]
    controller = SafeController(files, settings.largest_age, reading_limits(robot), environment.control_period)
    record = recorded or _play(config, robot, environment, controller, arm, targets)
    position, orientation = row_errors(record["pose"], record["target"][record["episode"]])
    metrics = {
        "timing": timing(record),
        "replay": replay(controller, record),
        "parity": export.parity,
        "episodes": _episodes(record, position, orientation, environment.scored_steps),
        "is_viewed": settings.view,
    }
    metrics["is_quick_enough"] = metrics["timing"]["latency_p99_ms"] <= 1e3 * settings.accepted_latency

    def draw() -> Drawn:
        figures = {
            "latency": latency_histogram(record["latency"][np.isin(record["flag"], ASKED)], settings.accepted_latency),
            "error": errors_over_time(record, position),
        }
        first = record["episode"] == 0
        time = record["period"][first] * float(record["control_period"])
        animation = track_viewer(robot, time, record["joint_positions"][first], target_mark(record["target"][0]))
        page = deployment_report(f"{robot.name} in real time", metrics, animation, figures)
        return Drawn(figures, {"deploy": page})

    return Output(
        metrics,
        {"log": record},
        draw,
        records={"contract": contract},
        files=export.files,
        shown=(episode_table(metrics), f"deploy: {headline(metrics)}"),
    )


def _where(replay: str, out: Path) -> Path:
    """The record, also where it lay in this stage's own directory, which has just been moved out of the way."""
    path = Path(replay)
    if not path.exists() and path.resolve().is_relative_to(out.resolve()):
        return out.with_name(f"{out.name}.previous") / path.resolve().relative_to(out.resolve())
    return path


def _targets(config: Config, robot: Robot, held_out: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The first held-out targets that the motors reach in time, and their base commands."""
    lengths = held_out[command_column(config.policy.base)]
    rows = np.flatnonzero(arrives_in_time(robot, config.policy.environment, lengths))[: config.deploy.num_targets]
    if len(rows) < config.deploy.num_targets:
        raise artifacts.ArtifactError(
            f"deploy.num_targets: got {config.deploy.num_targets}, allowed: at most the {len(rows)} held-out targets in time"
        )
    return held_out["target"][rows], lengths[rows]


def _export(
    config: Config,
    robot: Robot,
    environment: EnvironmentConfig,
    policy: Policy,
    arm: SimulatedArm,
    targets: tuple[np.ndarray, np.ndarray],
) -> ControllerExport:
    """The files, checked against what the package's own controller did with every target in the simulation."""
    live = controller_functions(environment.controller, robot, policy)
    compiled = ControllerFunctions(jax.jit(live.begin), jax.jit(live.step))
    substeps, episodes = substeps_of(environment.control_period, arm.timestep), []
    with progress.compiling("the controller"):
        for row, (target, lengths) in enumerate(zip(*targets, strict=True)):
            arm.home(row)
            episodes.append(rehearse(compiled, arm, target, lengths, environment.episode_steps, substeps))
    readings, commands = map(np.stack, zip(*episodes, strict=True))
    files = config.deploy.files
    inner = in_precision(robot, files.precision)
    with jax.enable_x64(files.precision == "float64"):
        functions = controller_functions(environment.controller, inner, policy)
        deployed = deployed_controller(inner, functions.begin, functions.step, files.precision)
    return export_files(robot, deployed, files, Rehearsal(*targets, readings, commands))


def _play(
    config: Config,
    robot: Robot,
    environment: EnvironmentConfig,
    controller: SafeController,
    arm: SimulatedArm,
    targets: tuple[np.ndarray, np.ndarray],
) -> Record:
    settings, steps, period = config.deploy, environment.episode_steps, environment.control_period
    with ExitStack() as stack:
        advance = stack.enter_context(progress.track((len(targets[0]) + 1) * steps, "in real time"))
        show = None
        if settings.view:
            from qjrl.deployment.live_view import live_view

            show = stack.enter_context(live_view(arm.stepper.model, settings.port))
        schedule, episodes = Schedule(steps, period), []
        for played in deploy(controller, arm, targets, schedule, settings, config.seed, show):
            episodes.append(played)
            advance(steps)
    return as_record(episodes, targets, period, robot_hash(robot), controller.limits)


def _episodes(record: Record, position: np.ndarray, orientation: np.ndarray, scored_steps: int) -> list[dict]:
    found = []
    for episode, has_faults in enumerate(record["has_faults"].tolist()):
        rows = np.flatnonzero(record["episode"] == episode)[-scored_steps:]
        found.append(
            {
                "name": "target 1 with faults" if has_faults else f"target {episode + 1}",
                "position_error_mm": 1e3 * float(position[rows].mean()),
                "orientation_error_deg": float(np.degrees(orientation[rows].mean())),
                "flags": flagged(record, episode),
            }
        )
    return found
