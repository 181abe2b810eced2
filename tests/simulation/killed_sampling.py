"""Kills a sampling process again and again: python killed_sampling.py FOLDER KILLS. Run by test_sharding.py.

One process imports, compiles and makes the data set FOLDER/whole uninterrupted; then each process that samples into
FOLDER/killed is a fork of it, at work from its first millisecond. A fork has none of JAX's threads, so it looks up
what JAX computed for the same rows before; MuJoCo and the files are the real ones.
"""

import os
import random
import signal
import sys
import time
import warnings
from pathlib import Path

import jax

from qjrl.robot import load_robot
from qjrl.robot.verbs import Robot
from qjrl.simulation import mujoco_settle, sampling, settling
from qjrl.simulation.row_by_row import row_by_row
from qjrl.simulation.settle_problem import SettleConfig

ROWS_PER_SHARD = 2
SHARDS_PER_KILL = 2
SIMULATION = SettleConfig(batch_size=2, num_threads=1)


def remember_what_jax_computes() -> None:
    computed, known = {}, {}

    def look_up(function, robot, rows):
        key = (function, rows.tobytes())
        if key not in computed:
            computed[key] = row_by_row(function, robot, rows)
        return computed[key]

    def remembered(robot, config):
        if config not in known:
            known[config] = real(robot, config)
        return known[config]

    real = mujoco_settle.relaxation
    sampling.row_by_row = settling.row_by_row = look_up
    mujoco_settle.relaxation = remembered


def sample(robot: Robot, directory: Path, num_shards: int) -> None:
    size = sampling.SampleConfig(ROWS_PER_SHARD * num_shards, ROWS_PER_SHARD)
    sampling.sample_dataset(robot, SIMULATION, size, 0, directory)


def forked(robot: Robot, directory: Path, num_shards: int) -> int:
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        sample(robot, directory, num_shards)
        os._exit(0)
    return child


def main(folder: Path, kills: int) -> None:
    random.seed(0)
    robot = load_robot("qj_22")
    remember_what_jax_computes()
    sample(robot, folder / "whole", SHARDS_PER_KILL * kills)
    start = time.monotonic()
    os.waitpid(forked(robot, folder / "timed", 3), 0)
    longest = time.monotonic() - start
    for _ in range(kills):
        child = forked(robot, folder / "killed", SHARDS_PER_KILL * kills)
        time.sleep(random.uniform(0.0, longest))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        sys.stdout.write("killed\n" if os.WIFSIGNALED(status) else "ended\n")
    _, status = os.waitpid(forked(robot, folder / "killed", SHARDS_PER_KILL * kills), 0)
    sys.exit(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of forks of a process with threads
    jax.config.update("jax_enable_x64", True)
    main(Path(sys.argv[1]), int(sys.argv[2]))
