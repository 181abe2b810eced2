"""On a machine with an accelerator: the rates of training, fitting, solving and settling, and MJX against C MuJoCo.

    python experiments/accelerator/measure.py table.json --cases training fitting solving --seconds 300

No network, no data set, no run of `qjrl` before it: rows, targets and networks are made here, with the shipped values.
The cases go in the order of `CASES`; what fails is written down as such, and the rest goes on. The default sizes are for
a large GPU; `--robot qj_22 --rows 64 --arms 16 --steps 2` goes through it all on a small computer.
"""

import argparse
import dataclasses
import json
import tempfile
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl import artifacts
from qjrl.config import shipped
from qjrl.control.bases import environment_of
from qjrl.control.environment import residual_env
from qjrl.control.inversion import IKConfig, solve_model
from qjrl.control.nominal_environment import nominal_bank
from qjrl.control.policy_training import PolicyConfig
from qjrl.control.targets import draw_configurations, target_poses
from qjrl.learning.fitting import FitState, FittedNetwork, Rows, make_optimiser, mean_squared_error, train_epoch
from qjrl.learning.ppo.checkpointer import PROGRESS
from qjrl.learning.ppo.train import train
from qjrl.provenance import provenance
from qjrl.robot import load_robot
from qjrl.robot.forward_model import (
    ForwardModel,
    ForwardModelConfig,
    PoseFunction,
    make_network,
    model_inputs,
    pose_function,
)
from qjrl.robot.verbs import Robot
from qjrl.simulation.engine import EngineConfig, EngineKind
from qjrl.simulation.engines import make_engine
from qjrl.simulation.sampling import sample_lengths, sample_rows
from qjrl.simulation.settle_problem import Backend, SettleConfig
from qjrl.simulation.settling import settle
from qjrl.solvers import LeastSquaresConfig

# Rows that both engines settle, to be compared one by one.
COMPARED = 64
TARGETS = 512
EPOCHS = 10
# Scale of what the made-up forward model adds to the bends: that of what a fitted one corrects.
CORRECTION = 1e-3
# Their files in `conf/engine`.
ENGINES: dict[EngineKind, str] = {"minimal": "minimal", "mjx": "mjx", "mjx-warp": "mjx_warp"}


@dataclasses.dataclass(frozen=True)
class Bench:
    """What is measured, and how much of it."""

    robot: Robot
    rows: int
    """Settled, solved and, four times as many, fitted."""
    arms: int
    """Trained with."""
    steps: int
    """Iterations of PPO that count; one more comes before them."""


Case = Callable[[Bench], dict[str, Any]]


def training(kind: EngineKind, bench: Bench) -> dict[str, Any]:
    """Environment steps a second of the default policy's training: a round of DAgger, iterations of PPO, learning included."""
    config = PolicyConfig()
    length = config.ppo.unroll_length
    dagger = dataclasses.replace(config.ppo.dagger, rounds=2, steps=bench.steps * length)
    num_steps = (bench.steps + 1) * length * bench.arms
    ppo = dataclasses.replace(config.ppo, dagger=dagger, num_steps=num_steps, checkpoint_every=num_steps)
    start = time.perf_counter()
    of_base = environment_of(config.environment, config.base)
    bank, engine = nominal_bank(bench.robot, of_base, TARGETS, 0), shipped(EngineConfig, f"engine/{ENGINES[kind]}")
    env = residual_env(bench.robot, of_base, bank, make_engine(bench.robot, engine))
    setup = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as directory:
        train(env, ppo, bench.arms, 0, Path(directory))
        records = artifacts.load(Path(directory) / PROGRESS)
    rounds, (first, *counted) = records[1:3], records[3:]
    # On a CPU, where collecting and learning are two programs.
    parts = [part for part in ("collecting_seconds", "learning_seconds") if part in first]
    return {
        "arms": bench.arms,
        "setup_seconds": setup,
        "dagger_first_seconds": rounds[0]["dagger_seconds"],
        "dagger_steps_per_second": rounds[1]["dagger_steps_per_second"],
        "ppo_first_seconds": length * bench.arms / first["steps_per_second"],
        "ppo_steps_per_second": float(np.median([record["steps_per_second"] for record in counted])),
        "ppo_iterations": len(counted),
        **{f"ppo_{part}": float(np.median([record[part] for record in counted])) for part in parts},
    }


def fitting(bench: Bench) -> dict[str, Any]:
    """Rows fitted a second by the default forward model's epochs alone: no evaluation, no checkpoints."""
    config = ForwardModelConfig()
    network = make_network(bench.robot, config)
    lengths = sample_lengths(bench.robot, 0, 0, 4 * bench.rows, 0.0)
    inputs = jax.vmap(lambda row: model_inputs(bench.robot, config.form, row))(jnp.asarray(lengths)).astype(jnp.float32)
    rows = Rows(inputs, jnp.sin(3.0 * inputs))
    parameters = network.init(jax.random.key(0), inputs[:1])["params"]
    state = FitState(parameters, make_optimiser(config.fit, 1).init(parameters), jax.random.key(1))
    run_epoch = jax.jit(train_epoch, static_argnums=(0, 1, 2), donate_argnums=3)
    first, (state, losses) = timed(lambda: run_epoch(config.fit, network, mean_squared_error, state, rows, 1))
    seconds = []
    for epoch in range(2, EPOCHS + 2):
        one, (state, losses) = timed(partial(run_epoch, config.fit, network, mean_squared_error, state, rows, epoch))
        seconds.append(one)
    fitted = losses.size * min(config.fit.batch_size, len(inputs))
    return {
        "rows": fitted,
        "batch_size": config.fit.batch_size,
        "first_seconds": first,
        "epoch_seconds": float(np.median(seconds)),
        "rows_per_second": fitted / float(np.median(seconds)),
        "loss": float(losses[-1]),
    }


def solving(bench: Bench) -> dict[str, Any]:
    """Targets inverted a second by the default method on one learned model, which is compiled in the first call."""
    config = IKConfig(least_squares=LeastSquaresConfig(batch_size=bench.rows))
    model = made_up_model(bench.robot)
    targets = target_poses(bench.robot, draw_configurations(bench.robot, "uniform", bench.rows, 0))
    solve = partial(solve_model, bench.robot, targets, model, config, 0)
    first, _ = timed(solve)
    seconds, found = timed(solve)
    return {
        "targets": bench.rows,
        "first_seconds": first,
        "targets_per_second": bench.rows / seconds,
        "solved_share": float(np.mean(found.converged)),
    }


def against_c(backend: Backend, bench: Bench) -> dict[str, Any]:
    """Distance between the tips that the same commands settle at in MJX, float32, and in C."""
    count = min(COMPARED, bench.rows)
    in_c = sample_rows(bench.robot, SettleConfig(), 0, 0, count)
    config = SettleConfig(backend=backend, batch_size=count)
    seconds, in_mjx = timed(lambda: settle(bench.robot, in_c["cable_lengths"], config=config))
    both = in_c["converged"] & in_mjx.converged
    if not both.any():
        raise RuntimeError(f"none of {count} rows settled in both engines")
    millimetres = 1e3 * np.linalg.norm(in_c["pose"][both, :3] - in_mjx.pose[both, :3], axis=1)
    return {
        "rows": count,
        "settled_in_both": int(both.sum()),
        "tip_median_mm": float(np.median(millimetres)),
        "tip_largest_mm": float(millimetres.max()),
        "mjx_first_seconds": seconds,
    }


def settling(backend: Backend, bench: Bench) -> dict[str, Any]:
    """Rows settled a second in MJX; the first call compiles."""
    config = SettleConfig(backend=backend, batch_size=bench.rows)
    lengths = sample_lengths(bench.robot, 0, 0, bench.rows, 0.0)
    first, _ = timed(lambda: settle(bench.robot, lengths, config=config))
    seconds, result = timed(lambda: settle(bench.robot, lengths, config=config))
    unsettled = int(np.sum(~result.converged))
    return {
        "rows": bench.rows,
        "first_seconds": first,
        "rows_per_second": bench.rows / seconds,
        "unsettled": unsettled,
    }


# In the order in which they are wanted, the cheap ones first: MJX compiles for minutes.
CASES: dict[str, Case] = {
    "training": partial(training, "minimal"),
    "fitting": fitting,
    "solving": solving,
    "mjx-against-c": partial(against_c, "mjx"),
    "mjx-settling": partial(settling, "mjx"),
    "mjx-training": partial(training, "mjx"),
    "warp-against-c": partial(against_c, "mjx-warp"),
    "warp-settling": partial(settling, "mjx-warp"),
    "warp-training": partial(training, "mjx-warp"),
}


def made_up_model(robot: Robot) -> PoseFunction:
    """The default forward model with random parameters, near the closed form."""
    config = ForwardModelConfig()
    config = dataclasses.replace(config, network=dataclasses.replace(config.network, zero_output=False))
    parameters = make_network(robot, config).init(jax.random.key(0), jnp.zeros((1, robot.num_cables)))["params"]
    zeros = jnp.zeros(robot.num_cables, jnp.float32)
    return pose_function(robot, ForwardModel(FittedNetwork(parameters, zeros, zeros + CORRECTION), config))


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds by the clock, until all is computed, and what came out."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result


def case_named(text: str) -> str:
    """The name of a case, from its name or its number, from 1."""
    names = list(CASES)
    name = names[int(text) - 1] if text.isdecimal() and 1 <= int(text) <= len(names) else text
    if name not in CASES:
        allowed = ", ".join(f"{number} {known}" for number, known in enumerate(names, 1))
        raise argparse.ArgumentTypeError(f"got {text}, allowed: {allowed}")
    return name


def positive(text: str) -> int:
    """A size."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"got {text}, allowed: an integer of at least 1")
    return int(text)


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description="Rates of all parts on this machine, as JSON.")
    parser.add_argument("table", type=Path)
    parser.add_argument("--cases", type=case_named, nargs="+", default=list(CASES), help=", ".join(CASES))
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which no further case starts")
    parser.add_argument("--robot", default="qj_2222")
    parser.add_argument("--rows", type=positive, default=4096)
    parser.add_argument("--arms", type=positive, default=4096)
    parser.add_argument("--steps", type=positive, default=10, help="iterations of PPO that count")
    return parser.parse_args()


def main() -> None:
    """Writes the table after every case, so that nothing measured is lost."""
    begun, arguments = time.monotonic(), parse()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_default_matmul_precision", "highest")  # as the command does
    bench = Bench(load_robot(arguments.robot), arguments.rows, arguments.arms, arguments.steps)
    cases: dict[str, Any] = {}
    about = {
        "robot": arguments.robot,
        "devices": [device.device_kind for device in jax.devices()],
        "jax": jax.__version__,
        "machine": provenance({}, None, None)["hardware"],
    }
    for name in arguments.cases:
        start = time.monotonic()
        if start - begun > arguments.seconds:
            cases[name] = {"skipped": f"{start - begun:.0f} s had passed"}
        else:
            cases[name] = attempted(CASES[name], bench)
            cases[name]["case_seconds"] = time.monotonic() - start
        print(name, json.dumps(cases[name]), flush=True)
        artifacts.write_json(arguments.table, about | {"cases": cases})


def attempted(case: Case, bench: Bench) -> dict[str, Any]:
    """What a case measures, or how it failed: the next one may well work."""
    try:
        return case(bench)
    except Exception as error:
        traceback.print_exc()
        return {"failed": f"{type(error).__name__}: {error}"}


if __name__ == "__main__":
    main()
