"""Stage `sample`: settle cable commands over the feasible space and write the data set."""

import dataclasses
import logging
from pathlib import Path

import numpy as np

from qjrl import artifacts, progress
from qjrl.report.output import Output
from qjrl.robot import robot_from_mapping, robot_hash
from qjrl.simulation.sampling import SampleConfig, num_rows, row_settings, rows_done, sample_dataset
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.sharding import join_parts, part_directories, remove_parts
from qjrl.stage_config import RobotStageConfig

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig
    sample: SampleConfig

    @property
    def part(self) -> str | None:
        """Name of the part of the rows that this process makes; None: all of them."""
        return None if self.sample.shard is None else f"{self.sample.shard}-of-{self.sample.num_shards}"

    def whole(self) -> "Config":
        """All rows: the same for every part and every number of parts."""
        sample = dataclasses.replace(self.sample, shard=None, num_shards=SampleConfig.num_shards)
        return dataclasses.replace(self, sample=sample)

    def parts(self) -> dict[str, "Config"]:
        """Every part that the whole is made of."""
        samples = [dataclasses.replace(self.sample, shard=shard) for shard in range(self.sample.num_shards)]
        configs = [dataclasses.replace(self, sample=sample) for sample in samples]
        return {str(config.part): config for config in configs}


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`manifest.json` and shards are written as rows settle; see `qjrl.simulation.sampling` and, where parts are there, `sharding`."""
    del inputs
    robot = robot_from_mapping(config.robot)
    total, identity = num_rows(config.sample), robot_hash(robot)
    parts = artifacts.parts_of(out)
    if config.part is None and part_directories(parts):
        _join(config, parts, out, identity)
    with progress.track(total, "settling", already=rows_done(out, identity)) as advance:
        sample_dataset(robot, config.simulation, config.sample, config.seed, out, advance)
    data = artifacts.load(out, identity)
    unsettled = int(np.sum(~data["converged"]))
    line = f"sample: {len(data['seed'])} rows, {unsettled} never settled and are left out of training"
    return Output(shown=(line,))


def _join(config: Config, parts: Path, out: Path, identity: str) -> None:
    """Parts that other processes made become the data set; they go once it stands."""
    if rows_done(out, identity) < config.sample.num_samples:
        settings = row_settings(config.simulation, config.sample.home_share, config.seed)
        join_parts(parts, out, identity, settings, config.sample.num_samples)
        log.info("sample: joined the rows of %s", parts.name)
    remove_parts(parts)
