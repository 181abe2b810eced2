"""The command with two small stages in place of the real ones, and only the files that these need."""

import dataclasses
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from command import Command, run_command

from qjrl import artifacts, pipeline
from qjrl.config import conf_folder
from qjrl.report.output import Output
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.stage_config import RobotStageConfig

CONF = """\
defaults:
  - defaults
  - robot: qj_22
  - simulation: mujoco
  - _self_
  - override hydra/job_logging: none
  - override hydra/hydra_logging: none
hydra:
  run: {dir: 'outputs/${run_name:${name}}'}
  sweep: {dir: 'outputs/${run_name:${name}}', subdir: '${job_name:${hydra.job.override_dirname}}'}
  output_subdir: null
  job: {name: qjrl}
"""


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    simulation: SettleConfig


def settle(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    del inputs
    artifacts.append_shard(out, {"pose": np.full((4, 9), config.seed, float)}, "robot")
    return Output()


def fit(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    del config, out
    mean = float(artifacts.load(inputs["first"], "robot")["pose"].mean())
    return Output({"mean": mean, "nothing": float("nan")})


@pytest.fixture
def qjrl(tmp_path, monkeypatch, capsys) -> Command:
    """The command with two small stages and the few files of `CONF`."""
    conf = tmp_path / "conf"
    for group in ("robot", "simulation"):
        shutil.copytree(conf_folder() / group, conf / group)
    (conf / "config.yaml").write_text(CONF)
    for module in ("cli.launch", "cli.sweeps", "cli.robot_files", "robot.loading"):
        monkeypatch.setattr(f"qjrl.{module}.conf_folder", lambda: conf)
    for name, run in (("first", settle), ("second", fit)):
        module = ModuleType(f"fake_{name}")
        module.__dict__.update(Config=Config, run=run)
        monkeypatch.setitem(sys.modules, f"fake_{name}", module)
    stages = {
        "first": pipeline.Stage("fake_first", "settles", writes="dataset"),
        "second": pipeline.Stage("fake_second", "fits", reads=("first",), writes="model"),
    }
    monkeypatch.setattr(pipeline, "STAGES", stages)
    monkeypatch.setattr(pipeline, "GROUPS", {"simulation": "first"})
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    for name in ("HYDRA_FULL_ERROR", "JAX_ENABLE_X64", "JAX_COMPILATION_CACHE_DIR", "MUJOCO_GL"):
        monkeypatch.setenv(name, "")
    return lambda *arguments: run_command(monkeypatch, capsys, *arguments)
