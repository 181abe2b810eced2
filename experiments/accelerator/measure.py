"""On a machine with an accelerator: MJX against C MuJoCo, then the rates of settling, fitting, solving and training.

    python experiments/accelerator/measure.py table.json

No network, no data set: rows and targets are made here. What fails is written down as such, and the rest goes on. The
numbers below are for a large GPU; `--robot qj_22 --rows 64 --arms 16 --steps 2` goes through it all on a small computer.
"""

import argparse
import dataclasses
import json
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from qjrl import artifacts
from qjrl.control.bases import bank_of, environment_of
from qjrl.control.environment import ResidualEnvironment
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.inversion import IKConfig, solve_target_set
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.train import train
from qjrl.provenance import provenance
from qjrl.robot import bends_from_cables, forward_kinematics, load_robot
from qjrl.robot.forward_model import ForwardModelConfig, pose_function
from qjrl.robot.model_fitting import fit_rows, settled_split
from qjrl.robot.verbs import Robot
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.sampling import sample_rows
from qjrl.simulation.settle_problem import Backend, SettleConfig
from qjrl.simulation.settling import settle

# Rows that both engines settle, to be compared one by one.
COMPARED = 64
EPOCHS = 5


@dataclasses.dataclass
class Sizes:
    """Of the machine."""

    rows: int
    arms: int
    steps: int


def against_c(robot: Robot, sizes: Sizes, backend: Backend) -> dict[str, Any]:
    """Distance between the tips that the same commands settle at in MJX, float32, and in C."""
    count = min(COMPARED, sizes.rows)
    mujoco = sample_rows(robot, SettleConfig(), 0, 0, count)
    mjx = settle(robot, mujoco["cable_lengths"], config=SettleConfig(backend=backend, batch_size=count))
    millimetres = 1e3 * np.linalg.norm(mujoco["pose"][:, :3] - np.asarray(mjx.pose)[:, :3], axis=1)
    both = mujoco["converged"] & np.asarray(mjx.converged)
    return {
        "rows": count,
        "settled_in_both": int(both.sum()),
        "tip_median_mm": float(np.median(millimetres[both])),
        "tip_largest_mm": float(millimetres[both].max()),
    }


def settling(robot: Robot, sizes: Sizes, backend: Backend) -> dict[str, Any]:
    """Settled rows a second in MJX; the second time, when all is compiled."""
    config = SettleConfig(backend=backend, batch_size=sizes.rows)
    lengths = sample_rows(robot, SettleConfig(max_time=0.1), 0, 0, sizes.rows)["cable_lengths"]
    once = lambda: settle(robot, lengths, config=config)  # noqa: E731
    first, _ = timed(once)
    second, result = timed(once)
    return {
        "rows": sizes.rows,
        "first_seconds": first,
        "rows_per_second": sizes.rows / second,
        "unsettled": int(np.sum(~np.asarray(result.converged))),
    }


def fitting(robot: Robot, sizes: Sizes) -> dict[str, Any]:
    """Rows fitted a second, of the default network on closed-form poses."""
    lengths = sample_rows(robot, SettleConfig(max_time=0.1), 0, 0, 4 * sizes.rows)["cable_lengths"]
    data = closed_form_rows(robot, lengths)
    config = ForwardModelConfig()
    config = dataclasses.replace(config, fit=dataclasses.replace(config.fit, epochs=EPOCHS))
    split = settled_split(data, 0.1, 0)
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        fit_rows(robot, config, split, 0, Path(first))
        seconds, _ = timed(lambda: fit_rows(robot, config, split, 0, Path(second)))
    return {"rows": len(lengths), "rows_per_second": EPOCHS * len(lengths) / seconds}


def solving(robot: Robot, sizes: Sizes) -> dict[str, Any]:
    """Targets inverted a second by least squares."""
    solve = lambda: solve_target_set(robot, pose_function(robot, None), IKConfig(), "uniform", sizes.rows, 0)  # noqa: E731
    solve()
    seconds, found = timed(solve)
    return {
        "targets": sizes.rows,
        "targets_per_second": sizes.rows / seconds,
        "solved": float(found["converged"].mean()),
    }


def training(robot: Robot, sizes: Sizes, engine: Backend | Literal["minimal"]) -> dict[str, Any]:
    """Environment steps a second of PPO, learning included, in the paper's environment of so many arms."""
    config = environment_of(EnvironmentConfig(), "dither")
    targets = solve_target_set(robot, pose_function(robot, None), IKConfig(), "uniform", 512, 0)
    bank = bank_of(targets, "dither", np.arange(512))
    simulation = SettleConfig() if engine == "minimal" else SettleConfig(backend=engine)
    stepper = make_stepper(robot, sizes.arms, simulation, is_minimal=engine == "minimal")
    environment = ResidualEnvironment(robot, config, bank, stepper, 0)
    ppo = PPOConfig(num_steps=sizes.steps * 20 * sizes.arms, checkpoint_every=1000)
    with tempfile.TemporaryDirectory() as directory:
        train(environment, ppo, 0, Path(directory))
        records = artifacts.load(Path(directory) / "progress.jsonl")[2:]
    rates = [record["steps_per_second"] for record in records]
    return {"arms": sizes.arms, "steps_per_second": float(np.median(rates)), "iterations": len(rates)}


def closed_form_rows(robot: Robot, lengths: np.ndarray) -> dict[str, np.ndarray]:
    """As a data set would hold them."""
    bends = jax.vmap(lambda row: bends_from_cables(robot, row))(jnp.asarray(lengths))
    poses = jax.vmap(lambda row: forward_kinematics(robot, row))(bends)
    every = {"converged": np.ones(len(lengths), bool), "seed": np.arange(len(lengths))}
    return {"cable_lengths": lengths, "bends": np.asarray(bends), "pose": np.asarray(poses)} | every


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds by the clock, until all is computed, and what came out."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result


def main() -> None:
    """Writes the table after every case, so that nothing measured is lost."""
    parser = argparse.ArgumentParser(description="Rates of all parts on this machine, as JSON.")
    parser.add_argument("table", type=Path)
    parser.add_argument("--robot", default="qj_2222")
    parser.add_argument("--rows", type=int, default=4096)
    parser.add_argument("--arms", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=10)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    robot, sizes = load_robot(arguments.robot), Sizes(arguments.rows, arguments.arms, arguments.steps)
    cases: dict[str, Callable[[], dict[str, Any]]] = {
        "training, minimal coordinates": lambda: training(robot, sizes, "minimal"),
        "fitting": lambda: fitting(robot, sizes),
        "solving": lambda: solving(robot, sizes),
        "MJX against C MuJoCo": lambda: against_c(robot, sizes, "mjx"),
        "settling, MJX": lambda: settling(robot, sizes, "mjx"),
        "training, MJX": lambda: training(robot, sizes, "mjx"),
        "MJX with Warp against C MuJoCo": lambda: against_c(robot, sizes, "mjx-warp"),
        "settling, MJX with Warp": lambda: settling(robot, sizes, "mjx-warp"),
        "training, MJX with Warp": lambda: training(robot, sizes, "mjx-warp"),
    }
    table: dict[str, Any] = {
        "robot": arguments.robot,
        "devices": [device.device_kind for device in jax.devices()],
        "jax": jax.__version__,
        "machine": provenance({}, None, None)["hardware"],
    }
    for name, case in cases.items():
        try:
            table[name] = case()
        except Exception as error:  # the next case may well work
            traceback.print_exc()
            table[name] = {"failed": f"{type(error).__name__}: {error}"}
        print(name, json.dumps(table[name]), flush=True)
        artifacts.write_json(arguments.table, table)


if __name__ == "__main__":
    main()
