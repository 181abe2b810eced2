"""Stage `pretension`: the least pretension that keeps every strand taut over the workspace or along a path."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from qjrl import artifacts, progress
from qjrl.control.tension import pretension as search
from qjrl.control.tension import pretension_numbers as numbers
from qjrl.control.tension.path import cable_quantity, read_path
from qjrl.control.tension.poses import single_segment_poses
from qjrl.control.tension.pretension import PretensionConfig, lowest_tension
from qjrl.control.tension_check import TensionCheck, check_tension
from qjrl.report.output import Drawn, Output
from qjrl.report.pretension import maps, report
from qjrl.robot import robot_from_mapping
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("at_pretension",)

    simulation: SettleConfig
    pretension: PretensionConfig

    def check(self) -> None:
        if self.pretension.path is not None:  # a file that is no path is refused before any work
            read_path(robot_from_mapping(self.robot), self.pretension.path)

    @property
    def files(self) -> dict[str, str]:
        """Files that the stage reads beside its inputs, and their hashes."""
        file = self.pretension.path
        return {} if file is None else {file: artifacts.hash_of_file(Path(file))}


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`metrics.json`, `tensions.npz`, figures and `report.html`; table and override are shown."""
    del inputs, out
    robot, settings = robot_from_mapping(config.robot), config.pretension
    poses = search.poses_to_keep(robot, settings, config.seed)
    with progress.track((len(search.curve_of(robot, settings)) + 1) * len(poses), "settling") as advance:
        found = search.survey(robot, settings, config.simulation, poses, advance)
        choice = search.choose(robot, settings, config.simulation, found, advance)
    checks = found.checks | {choice.at: choice.check}
    shown = {pretension: checks[pretension] for pretension in dict.fromkeys((float(robot.pretension), choice.at))}
    metrics = numbers.metrics_of(robot, settings, found, choice) | _on_fresh_poses(robot, config, choice.at)

    def draw() -> Drawn:
        pictures = _pictures(robot, config, metrics, shown)
        figures = {name: figure for name, (figure, _) in pictures.items()}
        return Drawn(figures, {"report": report.pretension_report(metrics, pictures)})

    return Output(
        metrics,
        {"tensions": _arrays(robot, found, choice)},
        draw,
        shown=(
            report.curve_table(metrics),
            f"as described: {metrics['own']['message'] or 'every pose is safe'}",
            *([] if settings.path is not None else [report.on_fresh_poses(metrics)]),
            report.headline(metrics) + (f": {metrics['override']}" if metrics["override"] else ""),
        ),
    )


def _on_fresh_poses(robot: Robot, config: Config, pretension: float) -> dict:
    """What the answer does to poses that the search has not seen."""
    settings = config.pretension
    if settings.path is not None:
        return {}
    poses = search.fresh_poses(robot, settings, config.seed)
    arm = search.at_pretension(robot, pretension)
    with progress.track(len(poses), "settling other poses") as advance:
        check = check_tension(arm, poses.cable_lengths, settings.least_tension, config.simulation, advance)
    return {"fresh": numbers.point_of(pretension, check, poses) | {"poses": len(poses), "message": check.message}}


def _arrays(robot: Robot, found: search.Survey, choice: search.Choice) -> dict[str, np.ndarray]:
    return {
        "cable_lengths": found.poses.cable_lengths,
        "cable_names": np.array(cable_quantity(robot).columns),
        "bends": found.poses.bends,
        "pretension": np.array(list(found.checks)),
        "lowest_tension": found.lowest_tension,
        "at": np.array(choice.at),
        "strand_tension": choice.check.rest.strand_tension,
        "pose": choice.check.rest.pose,
        "converged": choice.check.rest.converged,
    }


def _pictures(
    robot: Robot, config: Config, metrics: dict, shown: dict[float, TensionCheck]
) -> dict[str, tuple[Any, str]]:
    """File name -> figure and caption."""
    settings = config.pretension
    least, chosen = settings.least_tension, metrics["least_pretension"]
    tensions = {_label(pretension): lowest_tension(check) for pretension, check in shown.items()}
    pictures = {
        "trade_offs": (
            maps.trade_offs(metrics["curve"], least, chosen),
            "What a pretension buys and costs; the dashed line is the answer."
            if chosen
            else "What a pretension costs.",
        )
    }
    if settings.path is not None:
        caption = "The least loaded strand at every row looked at of the path."
        return pictures | {"path": (maps.along_path(tensions, least), caption)}
    tips = {_label(pretension): check.rest.pose[:, :3] for pretension, check in shown.items()}
    caption = (
        "The least loaded strand of every pose where its tip rests; poses with less are drawn above those with more."
    )
    pictures["tip_map"] = (maps.tip_maps(tips, tensions, least), caption)
    caption = "The least loaded strand while one segment bends and the others are straight."
    return pictures | {"segment_map": (_segment_map(robot, config, list(shown)), caption)}


def _segment_map(robot: Robot, config: Config, pretensions: list[float]) -> Any:
    settings, tensions = config.pretension, {}
    poses = single_segment_poses(robot, settings.num_angles, settings.num_directions)
    with progress.track(len(pretensions) * len(poses), "settling single bends") as advance:
        for pretension in pretensions:
            arm = search.at_pretension(robot, pretension)
            check = check_tension(arm, poses.cable_lengths, settings.least_tension, config.simulation, advance)
            shape = (robot.num_segments, settings.num_angles, settings.num_directions)
            tensions[_label(pretension)] = lowest_tension(check).reshape(shape)
    return maps.segment_maps(tensions, robot.config.joint.bend_limit_deg)


def _label(pretension: float) -> str:
    return f"{pretension:g} N at home"
