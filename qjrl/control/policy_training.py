"""Train the residual policy on a target bank, evaluate it on targets set apart, and measure what learning costs."""

import dataclasses
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.artifacts import append_json_line
from qjrl.config import ConfigError, NotIdentity, Range, configuration
from qjrl.control.bases import Base, bank_of, command_column, environment_of
from qjrl.control.environment import ResidualEnv, residual_env
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.evaluation import Evaluation, Evaluator, rows_in_time
from qjrl.control.targets import TARGET_SETS
from qjrl.keys import seed_for
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.policy import Policy, deterministic_action
from qjrl.learning.ppo.records import Record
from qjrl.learning.ppo.train import train
from qjrl.learning.tensorboard import tensorboard
from qjrl.robot import strand_commands
from qjrl.robot.verbs import Robot
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engine_stepper import EngineStepper
from qjrl.simulation.engines import make_engine, make_stepper

Arrays = Mapping[str, np.ndarray]

# Control steps over which the rate of the physics alone is measured, at every checkpoint.
_PHYSICS_STEPS = 10
PHYSICS_RATES = "physics_rates.jsonl"


@configuration
class PolicyConfig:
    """Group `policy`: the residual policy on top of a base."""

    base: Base = "estimate"
    """What the residual is added to. Ours: the learned IK, friction shaken off, fed back from the estimate of the arm; the
    paper's is the learned IK alone."""
    num_envs: Annotated[int, Range(2, 1_000_000)] = 512
    """Arms stepped together, over all processes. Ours, for two cores; the paper has 2048 on an A100."""
    num_evaluated: Annotated[int, Range(1, 100_000)] = 128
    """Targets of each set, set apart from the bank, on which the deterministic policy is evaluated at every checkpoint."""
    tensorboard: Annotated[bool, NotIdentity()] = False
    """Write the records as TensorBoard events too, in `tensorboard/` (their file names hold the host's name)."""
    environment: EnvironmentConfig = EnvironmentConfig()
    ppo: PPOConfig = PPOConfig()


@dataclasses.dataclass(frozen=True)
class TrainedPolicy:
    """The policy to keep and what its training said."""

    policy: Policy
    left_out: dict[str, int]
    """Target set -> targets of the bank whose base command the motors cannot ramp in in time."""


def check_training(config: PolicyConfig, engine: EngineConfig) -> None:
    """Refuses, without any work, what cannot be trained here.

    Raises:
        ConfigError: the devices of all processes cannot share the arms, or the control period is no multiple of the time
            step of the engine.
    """
    if config.num_envs % jax.device_count():
        raise ConfigError(
            f"policy.num_envs: got {config.num_envs}, allowed: a multiple of the {jax.device_count()} devices of all processes"
        )
    check_control_period(config.environment, engine.timestep)


def check_control_period(environment: EnvironmentConfig, timestep: float) -> None:
    """Refuses a control period that is no multiple of a physics' time step [s]; see `substeps_of`."""
    substeps_of(environment.control_period, timestep, "policy.environment.control_period")


def train_policy(
    robot: Robot, engine: EngineConfig, config: PolicyConfig, targets: Arrays, seed: int, directory: Path
) -> TrainedPolicy:
    """PPO on the bank; goes on where an interrupted training in `directory` stopped.

    Args:
        engine: what it trains in, and is evaluated in while it trains.
        targets: columns of `ik/bank.npz`. The last `num_evaluated` rows of each set that arrive in time are set apart.
    Raises:
        ConfigError: the bank has too few targets; see also `check_training`.
    """
    check_training(config, engine)
    rows = rows_in_time(robot, config.environment, targets, [command_column(config.base)])
    for name, found in rows.items():
        if len(found) <= config.num_evaluated:
            raise ConfigError(
                f"policy.num_evaluated: got {config.num_evaluated}, allowed: fewer than the {len(found)} {name} targets of the bank"
            )
    trained_on = np.concatenate([found[: -config.num_evaluated] for found in rows.values()])
    evaluated = np.concatenate([found[-config.num_evaluated :] for found in rows.values()])
    of_base = environment_of(config.environment, config.base)
    evaluate_stepper = make_stepper(robot, len(evaluated), engine)
    evaluation_seed = seed_for(seed, "arms of the checkpoints' evaluation")
    evaluator = Evaluator(robot, of_base, bank_of(targets, config.base, evaluated), evaluate_stepper, evaluation_seed)
    bank = bank_of(targets, config.base, trained_on)
    env = residual_env(robot, of_base, bank, make_engine(robot, engine))
    evaluate = lambda policy: _medians(evaluator.evaluate(acting(policy)), targets["target_set"][evaluated])  # noqa: E731
    with ExitStack() as stack:
        callbacks = [_physics_rates(env, config.num_envs, directory / PHYSICS_RATES)]
        if config.tensorboard:
            callbacks.append(stack.enter_context(tensorboard(directory / "tensorboard")))
        policy = train(env, config.ppo, config.num_envs, seed, directory, evaluate, "median_mm", callbacks)
    left_out = {name: int(np.sum(targets["target_set"] == i)) - len(rows[name]) for i, name in enumerate(TARGET_SETS)}
    return TrainedPolicy(policy, left_out)


def acting(policy: Policy) -> Callable[[np.ndarray], np.ndarray]:
    """The deterministic policy as a function of the actor's observations."""
    act = jax.jit(deterministic_action)
    return lambda observation: np.asarray(act(policy, observation))


def _medians(evaluation: Evaluation, target_set: np.ndarray) -> dict[str, float]:
    """Median errors on every set, and over all: by which the policy to keep is chosen."""
    millimetres, is_valid = 1e3 * evaluation.position_error, evaluation.is_valid
    medians = {
        f"{name}_median_mm": _median(millimetres[is_valid & (target_set == i)]) for i, name in enumerate(TARGET_SETS)
    }
    return medians | {"median_mm": _median(millimetres[is_valid])}


def _median(values: np.ndarray) -> float:
    """NaN where no episode is sound: such a checkpoint is never the best."""
    return float(np.median(values)) if len(values) else float("nan")


def _physics_rates(env: ResidualEnv, num_envs: int, path: Path) -> Callable[[Record], None]:
    """A callback that measures, at every checkpoint, control steps a second of the engine alone: between the iterations that
    it is compared with, as a machine's speed varies. Of several processes the first measures, and is taken for all."""
    stepper = EngineStepper(env.engine, num_envs // jax.process_count())
    held = np.asarray(strand_commands(env.robot, jnp.zeros(env.robot.num_cables)))
    substeps = substeps_of(env.config.control_period, stepper.timestep)

    def measure(record: Record) -> None:
        if "evaluation/median_mm" not in record:
            return
        stepper.step(held, substeps)
        stepper.wait()
        start = time.perf_counter()
        for _ in range(_PHYSICS_STEPS):
            stepper.step(held, substeps)
        stepper.wait()
        rate = _PHYSICS_STEPS * num_envs / (time.perf_counter() - start)
        append_json_line(path, {"env_steps": record["env_steps"], "physics_steps_per_second": rate})

    return measure
