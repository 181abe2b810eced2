"""Evaluate a controller: one episode for every target of a bank, under given randomisation, errors at the end."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import ConfigError
from qjrl.control import episode
from qjrl.control.bases import environment_of
from qjrl.control.episode import Bank, EnvironmentConfig, tasks_of
from qjrl.control.motors import action_size, ramp_time
from qjrl.control.randomisation import RandomisationConfig
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.environment import ACTOR_KEY
from qjrl.robot import joint_positions, strand_commands
from qjrl.robot.verbs import Robot, home
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.stepping import Stepper

# Actor observations (n, size) -> actions (n, action size) in [-1, 1].
Act = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Means over the scored end of one episode a target; rows that diverged or whose arm was lost are not valid."""

    position_error: np.ndarray
    """(n,) [m]."""
    orientation_error: np.ndarray
    """(n,) [rad]."""
    strand_tension: np.ndarray
    """(n, strands) [N], one step before the end."""
    position_trace: np.ndarray
    """(steps, n) position error after every control step [m]."""
    is_valid: np.ndarray
    """(n,)."""


def arrives_in_time(robot: Robot, config: EnvironmentConfig, base_lengths: np.ndarray) -> np.ndarray:
    """Which base commands (n, num_cables) [m] the motors can ramp in before `latest_arrival`."""
    times = jax.vmap(lambda row: ramp_time(robot, row))(jnp.asarray(base_lengths))
    return np.asarray(times) <= config.latest_arrival


def rows_in_time(
    robot: Robot, config: EnvironmentConfig, targets: Mapping[str, np.ndarray], columns: Iterable[str]
) -> dict[str, np.ndarray]:
    """Target set -> its rows in a target bank at which the base commands of all `columns` arrive in time."""
    in_time = np.all([arrives_in_time(robot, config, targets[name]) for name in columns], axis=0)
    return {name: np.flatnonzero((targets["target_set"] == i) & in_time) for i, name in enumerate(TARGET_SETS)}


def first_in_time(
    robot: Robot,
    config: EnvironmentConfig,
    targets: Mapping[str, np.ndarray],
    columns: Iterable[str],
    count: int,
    setting: str,
) -> dict[str, np.ndarray]:
    """`targets`, with these base commands alone, of the first `count` of the `rows_in_time` of each target set.

    Raises:
        ConfigError: there are fewer; `setting` is the name of `count`.
    """
    rows = rows_in_time(robot, config, targets, columns)
    for name, found in rows.items():
        if len(found) < count:
            raise ConfigError(f"{setting}: got {count}, allowed: at most {len(found)} ({name})")
    chosen = np.concatenate([found[:count] for found in rows.values()])
    return {name: targets[name][chosen] for name in ("target", "target_set", *columns)}


def do_nothing(observation: np.ndarray, action_size: int) -> np.ndarray:
    """The base controller alone: a residual that never moves."""
    return np.zeros((len(observation), action_size), np.float32)


class Evaluator:
    """A set of targets with its own simulations; every controller gets the same parameters and the same noise.

    The physics is a stepper's, on the host; everything else are the pure functions that train, in the caller's precision.
    """

    def __init__(self, robot: Robot, config: EnvironmentConfig, bank: Bank, stepper: Stepper, seed: int):
        self._robot, self._config, self._stepper = robot, config, stepper
        self._substeps = substeps_of(config.control_period, stepper.timestep)
        rows = jnp.arange(len(bank.target))
        keys = jax.vmap(partial(jax.random.fold_in, jax.random.key(seed)))(rows)
        tasks = tasks_of(config, robot, bank)
        self._begun = _compiled(config).begin(robot, tasks, keys, rows, jnp.zeros(len(rows), bool))
        self._home = np.asarray(joint_positions(robot, home(robot)))
        self._held = np.asarray(strand_commands(robot, jnp.zeros(robot.num_cables)))

    def evaluate(self, act: Act | None = None, advance=None) -> Evaluation:
        """Run one episode of every target; without `act`, the base controller alone.

        Args:
            act: actor observations to actions.
            advance: called with the number of environment steps made.
        """
        robot, stepper, compiled = self._robot, self._stepper, _compiled(self._config)
        size = action_size(self._config.residual, robot)
        act = act or (lambda observation: do_nothing(observation, size))
        everyone = np.arange(stepper.num_sims)
        stepper.reset(everyone, self._home, self._held, jax.tree.map(np.asarray, self._begun.parameters))
        begun = dataclasses.replace(self._begun.state, key=jax.random.clone(self._begun.state.key))
        state, observation = compiled.restart(robot, begun, stepper.read())
        position, orientation, is_valid = [], [], np.ones(len(everyone), bool)
        tension = np.zeros(0)
        for _ in range(self._config.episode_steps):
            tension = np.array(stepper.read().strand_tension)
            action = jnp.asarray(act(np.asarray(observation[ACTOR_KEY])), state.control.residual.dtype)
            planned, commands = compiled.command(robot, state, action)
            stepper.step(np.asarray(commands), self._substeps)
            seen = stepper.read()
            outcome = compiled.observe(robot, planned, seen)
            state, observation = outcome.state, outcome.observation
            is_valid &= np.asarray(seen.is_sound) & ~np.asarray(outcome.is_lost)
            position.append(np.asarray(outcome.metrics["position_error"]))
            orientation.append(np.asarray(outcome.metrics["orientation_error"]))
            if advance:
                advance(len(everyone))
        scored = slice(-self._config.scored_steps, None)
        mean_position, mean_orientation = (np.mean(errors[scored], axis=0) for errors in (position, orientation))
        is_valid &= np.isfinite(mean_position) & np.isfinite(mean_orientation)
        return Evaluation(mean_position, mean_orientation, tension, np.stack(position), is_valid)


@dataclasses.dataclass(frozen=True)
class _Compiled:
    """The functions of `episode` over many arms."""

    begin: Callable[..., Any]
    restart: Callable[..., Any]
    command: Callable[..., Any]
    observe: Callable[..., Any]


def _compiled(config: EnvironmentConfig) -> _Compiled:
    """What tells bases apart are numbers of a task: all share what is compiled for the one that has nothing."""
    return _compiled_once(environment_of(config, "nominal"))


@cache
def _compiled_once(config: EnvironmentConfig) -> _Compiled:
    """What is drawn matters to `begin` alone, but for the encoders' noise: other ranges compile nothing else again."""
    begin = jax.jit(jax.vmap(partial(episode.begin, config), in_axes=(None, None, 0, 0, 0)))
    same = RandomisationConfig(encoder_noise_deg=config.randomisation.encoder_noise_deg)
    if config.randomisation != same:
        return dataclasses.replace(_compiled_once(dataclasses.replace(config, randomisation=same)), begin=begin)

    def over_arms(function: Callable[..., Any]) -> Callable[..., Any]:
        return jax.jit(jax.vmap(partial(function, config), in_axes=(None, 0, 0)))

    return _Compiled(begin, *map(over_arms, (episode.restart, episode.command, episode.observe)))
