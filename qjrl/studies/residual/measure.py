"""Errors over time above the encoders' floor, the baseline's tuning, the base under each parameter alone, and ablations."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl import artifacts
from qjrl.config import Range, configuration, identity_of
from qjrl.control.bases import Base, bank_of, command_column, controller_name, environment_of
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.evaluation import Act, Evaluation, Evaluator, first_in_time
from qjrl.control.motors import ramp_time
from qjrl.control.policy_training import PolicyConfig, acting, train_policy
from qjrl.control.targets import TARGET_SETS
from qjrl.keys import key_for, seed_for
from qjrl.learning.ppo.policy import Policy
from qjrl.measured import read_metrics
from qjrl.records import NUMBER
from qjrl.robot import bends_from_cables
from qjrl.robot.verbs import Robot
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.rested import require_valid
from qjrl.studies.residual.ablations import ABLATIONS, ablations
from qjrl.studies.residual.noise_floor import encoder_floor
from qjrl.studies.residual.parameter_effects import one_at_a_time

Arrays = Mapping[str, np.ndarray]

_ERRORS = {f"{name}_{key}": NUMBER for name in TARGET_SETS for key in ("median_mm", "p90_mm", "median_deg")}
_EVALUATED = {"identity": str, "errors": {"base": _ERRORS, "policy": _ERRORS}}
BASELINE: Base = "integral"


@configuration
class ResidualStudyConfig:
    """Group `residual`; all values ours."""

    num_targets: Annotated[int, Range(1, 100_000)] = 200
    """Held-out targets of each set."""
    baseline_gains: tuple[Annotated[float, Range(above=0.0)], ...] = (0.25, 0.5, 1.0, 2.0, 4.0)
    """Gains [1/s] with which the baseline is evaluated, to see that it is tuned."""
    share: Annotated[float, Range(above=0.0, high=1.0)] = 0.25
    """Share of the training's steps that every ablation has."""
    ablations: tuple[str, ...] = ABLATIONS
    """Which ablations are trained; none is allowed."""

    def __post_init__(self):
        for name in self.ablations:
            if name not in ABLATIONS:
                raise ValueError(f"ablations: got '{name}', allowed: {', '.join(ABLATIONS)}")


@dataclasses.dataclass(frozen=True)
class Subject:
    """The arm, its training and the held-out targets that all parts of the study use."""

    robot: Robot
    engine: EngineConfig
    config: PolicyConfig
    targets: Arrays
    """Columns of `held_out.npz`, of the chosen rows."""
    seed: int

    def evaluate(self, environment: EnvironmentConfig, base: Base, act: Act | None = None) -> Evaluation:
        """One controller on the targets, in the engine of the training."""
        count = len(self.targets["target"])
        stepper = make_stepper(self.robot, count, self.engine)
        bank = bank_of(self.targets, base, np.arange(count))
        seed = seed_for(self.seed, "arms of the residual study")
        return Evaluator(self.robot, environment_of(environment, base), bank, stepper, seed).evaluate(act)


def make_subject(
    robot: Robot, engine: EngineConfig, config: PolicyConfig, held_out: Arrays, num_targets: int, seed: int
) -> Subject:
    """The first targets of each set at which the base and the baseline arrive in time.

    Raises:
        ConfigError: there are fewer.
    """
    columns = {command_column(base) for base in (config.base, BASELINE)}
    targets = first_in_time(robot, config.environment, held_out, columns, num_targets, "residual.num_targets")
    return Subject(robot, engine, config, targets, seed)


def over_time(subject: Subject, policy: Policy) -> dict[str, np.ndarray]:
    """Controller -> position error (steps, n) [m]: learned IK, baseline, the policy's base, the policy; and the "floor"."""
    config = subject.config
    bases: list[Base] = list(dict.fromkeys(("learned", BASELINE, "dither", config.base)))
    traces = {controller_name(base): subject.evaluate(config.environment, base).position_trace for base in bases}
    name = controller_name(config.base, has_policy=True)
    traces[name] = subject.evaluate(config.environment, config.base, acting(policy)).position_trace
    return traces | {"floor": _floor(subject)}


def _floor(subject: Subject) -> np.ndarray:
    """(steps, n) [m]; not a number until the base command is ramped in."""
    config = subject.config.environment
    lengths = jnp.asarray(subject.targets[command_column(subject.config.base)])
    arrival = jax.vmap(lambda row: ramp_time(subject.robot, row))(lengths)
    bends = jax.vmap(lambda row: bends_from_cables(subject.robot, row))(lengths)
    noise, steps = config.randomisation.encoder_noise_deg, jnp.arange(1, config.episode_steps + 1)
    since = steps[:, None] * config.control_period - arrival
    frames = jnp.floor(since / config.control_period) + 1.0
    keys = jax.random.split(key_for(subject.seed, "encoder floor of the residual study"), len(steps))
    floor = jax.jit(jax.vmap(lambda frames, key: encoder_floor(subject.robot, bends, noise, frames, key)))
    return np.where(since >= 0.0, floor(jnp.maximum(frames, 1.0), keys), np.nan)


def tuning(subject: Subject, gains: Iterable[float], advance: Callable[[], None]) -> dict[float, dict[str, float]]:
    """Gain of the baseline's integral [1/s] -> its errors."""
    found = {}
    for gain in gains:
        integral = dataclasses.replace(subject.config.environment.integral, gain=gain)
        environment = dataclasses.replace(subject.config.environment, integral=integral)
        found[gain] = errors_of(subject.evaluate(environment, BASELINE), subject.targets["target_set"])
        advance()
    return found


def effects(subject: Subject, advance: Callable[[], None]) -> dict[str, dict[str, float]]:
    """Parameter, varied alone -> errors of the learned IK without feedback; "nothing" and "all" as marks."""
    found = {}
    for name, randomisation in one_at_a_time(subject.config.environment.randomisation).items():
        environment = dataclasses.replace(subject.config.environment, randomisation=randomisation)
        found[name] = errors_of(subject.evaluate(environment, "learned"), subject.targets["target_set"])
        advance()
    return found


def ablate(
    subject: Subject, bank: Arrays, settings: ResidualStudyConfig, directory: Path, advance: Callable[[], None]
) -> dict[str, Any]:
    """Ablation -> errors of the policy's base and of the policy, in its own environment; a finished one is read again."""
    variants, found = ablations(subject.config, settings.share), {}
    for name in settings.ablations:
        config, path = variants[name], directory / name.replace(", ", "-").replace(" ", "_")
        done = path / "evaluated.json"
        identity = artifacts.hash_of(
            [identity_of(config), identity_of(subject.engine), settings.num_targets, subject.seed]
        )
        if done.exists() and (known := read_metrics(done, _EVALUATED))["identity"] == identity:
            found[name] = known["errors"]
        else:
            trained = train_policy(subject.robot, subject.engine, config, bank, subject.seed, path)
            controllers = {"base": None, "policy": acting(trained.policy)}
            found[name] = {
                controller: errors_of(
                    subject.evaluate(config.environment, config.base, act), subject.targets["target_set"]
                )
                for controller, act in controllers.items()
            }
            artifacts.write_json(done, {"identity": identity, "errors": found[name]})
        advance()
    return found


def errors_of(evaluation: Evaluation, target_set: np.ndarray) -> dict[str, float]:
    """Median and p90 of each set: "uniform_median_mm", ..., "uniform_median_deg"."""
    millimetres, degrees = 1e3 * evaluation.position_error, np.degrees(evaluation.orientation_error)
    found = {}
    for index, name in enumerate(TARGET_SETS):
        rows = evaluation.is_valid & (target_set == index)
        require_valid(rows[target_set == index], f"residual: episodes to {name} targets")
        found[f"{name}_median_mm"] = float(np.median(millimetres[rows]))
        found[f"{name}_p90_mm"] = float(np.percentile(millimetres[rows], 90))
        found[f"{name}_median_deg"] = float(np.median(degrees[rows]))
    return found
