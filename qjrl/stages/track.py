"""Stage `track`: a path of poses becomes a cable trajectory, which is played in the physics."""

import dataclasses
from pathlib import Path

import numpy as np

from qjrl import artifacts, progress
from qjrl.control.path.paths import make_path, path_file
from qjrl.control.tension.path import cable_quantity
from qjrl.control.tracking.moving import moving_breaches, moving_message
from qjrl.control.tracking.playing import TrackConfig
from qjrl.control.tracking.run import Evaluated, Plan, command_times, make_plan, nominal_plan, num_periods, perform
from qjrl.control.tracking.trajectory import least_duration
from qjrl.report.output import Drawn, Output
from qjrl.report.track.figures import track_pictures
from qjrl.report.track.report import headline, track_report
from qjrl.report.track.tracked import Tracked, command_metrics, position_metrics, tracked_metrics, tracking_table
from qjrl.report.track.viewer import track_viewer
from qjrl.robot import robot_from_mapping
from qjrl.robot.forward_model import load_pose_function
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("build_mjcf",)

    simulation: SettleConfig
    track: TrackConfig

    def check(self) -> None:
        # a file that is no path of this arm is refused before any work
        make_path(self.track.path, self.track.shape, robot=robot_from_mapping(self.robot))
        substeps_of(self.track.period, self.simulation.timestep, "track.period")

    @property
    def files(self) -> dict[str, str]:
        """Files that the stage reads beside its inputs, and their hashes."""
        file = path_file(self.track.path)
        return {} if file is None else {str(file): artifacts.hash_of_file(file)}


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `trajectory.npz`, figures and `track.html`; the table is shown."""
    del out
    robot, settings = robot_from_mapping(config.robot), config.track
    model = load_pose_function(inputs["forward_model"] / "model", robot)
    with progress.compiling("the inverse kinematics of a whole path"):
        plan = make_plan(robot, model, config.simulation, settings, config.seed)
        nominal = nominal_plan(robot, plan, settings, config.seed)
    with progress.track(num_periods(settings, plan), "playing") as advance:
        evaluated = perform(robot, config.simulation, settings, plan, nominal, advance)
    tracked = {name: _tracked(one) for name, one in evaluated.items()}
    metrics = _metrics(robot, settings, plan, tracked)
    for name, one in evaluated.items():
        breaches = moving_breaches(robot, one.played)
        metrics["played"][name] |= {
            "breaches": [dataclasses.asdict(breach) for breach in breaches],
            "message": moving_message(breaches),
        }

    def draw() -> Drawn:
        cables, names = _cables(plan), _cable_names(robot)
        pictures = track_pictures(
            _positions(plan, evaluated["planned"]), tracked, cables, _bounds(robot, settings), names
        )
        animation = track_viewer(robot, *_movie(evaluated["planned"]), plan.path.pose[:, :3])
        title = f"Path {settings.path} on {robot.name}"
        page = track_report(title, metrics, settings.accepted_error, animation, pictures)
        return Drawn({name: figure for name, (figure, _) in pictures.items()}, {"track": page})

    return Output(
        metrics,
        {"trajectory": _columns(robot, settings, plan, evaluated["planned"])},
        draw,
        shown=(tracking_table(metrics["played"]), headline(metrics, settings.accepted_error)),
    )


def _tracked(one: Evaluated) -> Tracked:
    """What counts of a performance: from the plan's begin to its end."""
    moving, errors, played = one.is_moving, one.errors, one.played
    return Tracked(
        one.performance.trajectory.speed,
        one.performance.lead,
        played.time[moving],
        errors.position[moving],
        errors.across[moving],
        errors.along[moving],
        errors.orientation[moving],
        errors.speed[moving],
        played.strand_tension[moving],
        played.motor_force[moving],
        played.is_finite,
    )


def _metrics(robot: Robot, settings: TrackConfig, plan: Plan, tracked: dict[str, Tracked]) -> dict:
    trajectory, rest = plan.trajectory, plan.rest.rest
    commands = trajectory.at(command_times(trajectory, settings.period))
    ends = plan.cables.lengths(np.array([0.0, plan.path.length]))
    return {
        "plan": {
            "path": settings.path,
            "counts": plan.path.constraint,
            "num_waypoints": len(plan.path.distance),
            "length_m": plan.path.length,
            "is_closed": plan.path.is_closed,
            "speed": trajectory.speed,
            "duration_s": trajectory.duration,
            "quickest_s": trajectory.quickest,
            "least_s": least_duration(plan.cables.lengths, float(robot.motor_speed)),
            "model_position_max_mm": 1e3 * float(plan.model_error[0].max()),
            "model_orientation_max_deg": float(np.degrees(plan.model_error[1].max())),
            "cables_change_end_to_end_mm": 1e3 * float(np.abs(ends[1] - ends[0]).max()),
            **command_metrics(commands, settings.period, _bounds(robot, settings)),
        },
        "at_rest": {
            **position_metrics(*plan.rest_error),
            "tension_min_N": float(rest.strand_tension.min()),
            "tension_max_N": float(rest.strand_tension.max()),
            "motor_force_max_N": float(np.abs(rest.motor_force).max()),
        },
        "played": {name: tracked_metrics(one) for name, one in tracked.items()},
    }


def _bounds(robot: Robot, settings: TrackConfig) -> tuple[float, float, float]:
    return float(robot.motor_speed), settings.limits.acceleration, settings.limits.jerk


def _positions(plan: Plan, main: Evaluated) -> tuple[np.ndarray, np.ndarray]:
    """Where the tip should be and where it was, while the plan moves."""
    times, poses = main.played.time[main.is_moving], main.played.pose[main.is_moving]
    return plan.path.at(plan.trajectory.distances(times))[:, :3], poses[:, :3]


def _cables(plan: Plan) -> tuple[np.ndarray, ...]:
    """Times, and speed, acceleration and jerk of the cables then."""
    times = np.linspace(0.0, plan.trajectory.duration, 1000)
    return times, *plan.trajectory.derivatives(times)


def _cable_names(robot: Robot) -> list[str]:
    return [name.replace("_", " ") for name in verb(robot, "cable_names")(robot)]


def _movie(main: Evaluated) -> tuple[np.ndarray, np.ndarray]:
    """Times and joint positions of the animation: the plan and what comes right after it."""
    shown = main.played.time >= 0.0
    return main.played.time[shown], main.played.joint_positions[shown]


def _columns(robot: Robot, settings: TrackConfig, plan: Plan, main: Evaluated) -> dict[str, np.ndarray]:
    times, trajectory, played = command_times(plan.trajectory, settings.period), plan.trajectory, main.played
    return {
        "time": times,
        "cable_lengths": trajectory.at(times),
        "cable_names": np.array(cable_quantity(robot).columns),
        "planned_pose": plan.path.at(trajectory.distances(times)),
        "lead": np.array(main.performance.lead),
        "played_time": played.time,
        "played_command": played.command,
        "played_pose": played.pose,
        "played_joint_positions": played.joint_positions,
        "played_strand_tension": played.strand_tension,
        "position_error": main.errors.position,
        "orientation_error": main.errors.orientation,
    }
