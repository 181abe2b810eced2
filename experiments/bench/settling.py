"""Settled samples per second, the share of bare MuJoCo's rate that settling turns into useful steps, and what a fixed time
from home would cost instead."""

import tempfile
import time
from pathlib import Path

import jax
import mujoco
import numpy as np
from mujoco import batch

from qjrl import artifacts
from qjrl.cores import usable_cores
from qjrl.provenance import provenance
from qjrl.robot import build_mjcf, load_robot
from qjrl.simulation.mujoco_settle import Pool, settle_mujoco
from qjrl.simulation.sampling import SampleConfig, sample_dataset, sample_rows
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import nominal_problem, settle

ROBOT, NUM_ROWS, SHARD_SIZE, NUM_BARE_STEPS, NUM_REPEATS = "qj_2222", 2048, 1024, 60, 3
FIXED_TIME, NUM_FIXED = 1.6, 512  # [s] of simulated time, rows


def rates(count: int, start: tuple[float, float]) -> np.ndarray:
    """Steps per second since `start`, and per second of CPU time, which other programs disturb less."""
    return count / (np.array(now()) - np.array(start))


def now() -> tuple[float, float]:
    """Clock and CPU time of all threads [s]."""
    return time.perf_counter(), time.process_time()


def bare_rates(robot, config, problem) -> np.ndarray:
    """Rates of `mujoco.batch` alone, on the model that settles, with every simulation of the pool active."""
    pool = Pool(robot, config, config.batch_size)
    every = np.arange(config.batch_size)
    pool.start(every, every, problem)
    pool.batch.step()
    start = now()
    for _ in range(NUM_BARE_STEPS):
        pool.batch.step()
    return rates(config.batch_size * NUM_BARE_STEPS, start)


def settle_rates(robot, config, problem) -> tuple[np.ndarray, np.ndarray]:
    """Rates of settling, counting the steps of the rows alone, and the steps that each row took."""
    start = now()
    steps = settle_mujoco(robot, problem, config, lambda count: None).steps
    return rates(steps.sum(), start), steps


def bench_efficiency(robot, config, lengths) -> None:
    """Settling between two measurements of bare steps, so that both see the same machine."""
    problem = nominal_problem(robot, lengths)
    ratios, steps = [], np.zeros(0)
    for _ in range(NUM_REPEATS):
        before = bare_rates(robot, config, problem)
        found, steps = settle_rates(robot, config, problem)
        bare = 0.5 * (before + bare_rates(robot, config, problem))
        ratios.append(found / bare)
        print(f"  {found[0]:7,.0f} useful steps/s settling, {bare[0]:7,.0f} bare")
    by_clock, by_cpu = np.median(ratios, axis=0)
    print(f"  settling / bare = {by_clock:.2f} (median of {NUM_REPEATS}); in steps per CPU second: {by_cpu:.2f}")
    print(f"  steps a row: mean {steps.mean():.0f}, 99th percentile {np.percentile(steps, 99):.0f}, most {steps.max()}")


def bench_fixed(robot, config, lengths) -> None:
    """The baseline: a fixed time from home with the robot's own damping, every strand crossing every joint."""
    simulations = batch.Batch(mujoco.MjModel.from_xml_string(build_mjcf(robot)), len(lengths), usable_cores())
    tip = simulations.site("tip").xpos
    simulations.qpos[:] = nominal_problem(robot, np.zeros((1, robot.num_cables))).joint_positions
    simulations.ctrl[:] = nominal_problem(robot, lengths).strand_commands
    start = now()
    simulations.step(nstep=round(FIXED_TIME / simulations.model.opt.timestep))
    fixed = rates(len(lengths), start)
    simulations.forward()
    start = now()
    rest = settle(robot, lengths, config=config)
    settled = rates(len(lengths), start)
    off = 1e3 * np.linalg.norm(tip - rest.pose[:, :3], axis=1)[rest.converged]
    print(f"  {len(lengths)} rows: settled {settled[0]:.0f} rows/s, {FIXED_TIME:g} s from home {fixed[0]:.0f} rows/s")
    print(f"  settled / fixed = {settled[0] / fixed[0]:.1f} by the clock, {settled[1] / fixed[1]:.1f} by CPU time")
    print(
        f"  after {FIXED_TIME:g} s the tip is off its rest by: median {np.median(off):.3f} mm, worst {off.max():.1f} mm"
    )


def bench_data_set(robot, config) -> None:
    """The whole of what the stage `sample` does, except for starting up."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        sample_dataset(robot, config, SampleConfig(NUM_ROWS, SHARD_SIZE), 0, Path(folder))
        seconds = time.perf_counter() - start
        converged = artifacts.load(folder)["converged"]
    print(f"  {NUM_ROWS / seconds:.0f} samples/s with their files, {np.sum(~converged)} of {NUM_ROWS} never settled")


def main() -> None:
    """Print all three, of the paper's arm at the shipped settings."""
    jax.config.update("jax_enable_x64", True)
    machine = provenance({}, None, None)["hardware"]
    robot, config = load_robot(ROBOT), SettleConfig()
    print(f"{machine['cpu']}, {machine['cores']} cores; mujoco {mujoco.__version__}")
    print(f"{ROBOT}, {NUM_ROWS} rows, to {config.speed_tolerance:g} rad/s")
    hurried = SettleConfig(max_time=0.1)  # compiles, and gives the commands
    lengths = sample_rows(robot, hurried, seed=0, start=0, count=NUM_ROWS)["cable_lengths"]
    bench_efficiency(robot, config, lengths)
    bench_fixed(robot, config, lengths[:NUM_FIXED])
    bench_data_set(robot, config)


if __name__ == "__main__":
    main()
