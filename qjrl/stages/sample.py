"""Stage `sample`: settle cable commands over the feasible space and write the data set."""

import dataclasses
import logging
from pathlib import Path

import numpy as np

from qjrl import artifacts, progress
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.simulation.sampling import SampleConfig, rows_done, sample_dataset
from qjrl.simulation.settle_problem import SettleConfig

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config:
    robot: dict
    simulation: SettleConfig
    sample: SampleConfig
    seed: int


def run(config: Config, inputs: dict[str, Path], out: Path) -> None:
    """Write `manifest.json` and shards; see `qjrl.simulation.sampling`."""
    del inputs
    robot = robot_from_mapping(config.robot)
    done = rows_done(out, robot_hash(robot))
    with progress.track(config.sample.num_samples, "settling", already=done) as advance:
        sample_dataset(robot, config.simulation, config.sample, config.seed, out, advance)
    data = artifacts.load(out, robot_hash(robot))
    unsettled = int(np.sum(~data["converged"]))
    log.info("sample: %d rows, %d never settled and are left out of training", len(data["seed"]), unsettled)
