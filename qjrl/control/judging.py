"""Judge a controller: one episode for every target of a bank, under given randomisation, errors at the end."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import ConfigError
from qjrl.control.environment import ResidualEnvironment
from qjrl.control.episode import Bank, EnvironmentConfig
from qjrl.control.motors import ramp_time
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.environment import ACTOR_KEY
from qjrl.robot.verbs import Robot
from qjrl.simulation.stepping import Stepper

# Actor observations (n, size) -> actions (n, action size) in [-1, 1].
Act = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Judgement:
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


class Judge:
    """A set of targets with its own simulations; every controller gets the same parameters and the same noise."""

    def __init__(self, robot: Robot, config: EnvironmentConfig, bank: Bank, stepper: Stepper, seed: int):
        self._config = config
        self._environment = ResidualEnvironment(robot, config, bank, stepper, seed, rows=np.arange(len(bank.target)))

    def judge(self, act: Act | None = None, advance=None) -> Judgement:
        """Run one episode of every target; without `act`, the base controller alone.

        Args:
            act: actor observations to actions.
            advance: called with the number of environment steps made.
        """
        environment, steps = self._environment, self._config.episode_steps
        act = act or (lambda observation: do_nothing(observation, environment.action_size))
        observation = environment.reset()
        position, orientation, is_valid = [], [], np.ones(environment.num_envs, bool)
        tension = environment.strand_tension.copy()
        for step in range(steps):
            if step == steps - 1:  # the last step resets the simulations
                tension = environment.strand_tension.copy()
            transition = environment.step(act(observation[ACTOR_KEY]))
            observation = transition.observation
            is_valid &= transition.valid & ~np.asarray(transition.terminated)
            position.append(transition.metrics["position_error"])
            orientation.append(transition.metrics["orientation_error"])
            if advance:
                advance(environment.num_envs)
        scored = slice(-self._config.scored_steps, None)
        mean_position, mean_orientation = (np.mean(errors[scored], axis=0) for errors in (position, orientation))
        is_valid &= np.isfinite(mean_position) & np.isfinite(mean_orientation)
        return Judgement(mean_position, mean_orientation, tension, np.stack(position), is_valid)
