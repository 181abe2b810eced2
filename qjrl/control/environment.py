"""The residual environment: many arms, each reaching one target with a base controller and a learned residual.

A thin shell around the pure functions of `episode`; the physics is a stepper. Episodes end by the time limit
(truncation) unless the arm is lost (termination). A diverged simulation is invalid and starts afresh.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.control import episode
from qjrl.control.arm_estimate import priors
from qjrl.control.episode import Bank, EnvironmentConfig, EpisodeState
from qjrl.control.faults import Faults
from qjrl.control.motors import action_size
from qjrl.control.observations import ControlState, TrueState
from qjrl.control.randomisation import RandomisationConfig
from qjrl.learning.ppo.environment import Observation, Transition
from qjrl.robot import joint_positions, strand_commands
from qjrl.robot.verbs import Robot
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.stepping import PhysicalParameters, Readout, Stepper


class ResidualEnvironment:
    """`num_envs` arms for PPO (`learning.ppo.environment.VectorEnv`) and, with `rows`, for judging controllers.

    With `rows=None` every episode draws a row of the bank at random, and the first episodes are cut short at random
    lengths so that the arms are spread over all phases of an episode. With `rows` arm i reaches row rows[i] of the
    bank, its parameters and noise a function of (seed, rows[i]) alone: the same for every controller. `first` is the number
    of the first arm, where others are somewhere else: what is drawn depends on an arm's number.
    """

    def __init__(
        self,
        robot: Robot,
        config: EnvironmentConfig,
        bank: Bank,
        stepper: Stepper,
        seed: int,
        rows: np.ndarray | None = None,
        first: int = 0,
    ):
        self.num_envs, self.action_size = stepper.num_sims, action_size(config.residual, robot)
        self.gives_advice = True
        self._robot, self._bank, self._stepper, self._rows = robot, bank, stepper, rows
        self._seed, self._first = seed, first
        self._substeps = substeps_of(config.control_period, stepper.timestep)
        self._believed = priors(config.estimate, robot, bank.base_lengths)
        self._compiled = _compile(config)
        self._home = np.asarray(joint_positions(robot, jnp.zeros((robot.num_segments, 2))))
        self._home_commands = np.asarray(strand_commands(robot, jnp.zeros(robot.num_cables)))
        self.observation_sizes = {key: value.shape[1] for key, value in self.reset().items()}

    def reset(self, seed: int | None = None, is_spread: bool = True) -> Observation:
        """Start every arm afresh, at rest at home; with another seed than its own, or without cutting first episodes short."""
        count = np.arange(self.num_envs)
        rows = np.full(self.num_envs, -1) if self._rows is None else np.asarray(self._rows)
        keys = jax.vmap(partial(jax.random.fold_in, jax.random.key(self._seed if seed is None else seed)))(
            jnp.asarray(self._first + count if self._rows is None else rows)
        )
        is_first = np.full(self.num_envs, self._rows is None and is_spread)
        begun = self._compiled.begin(self._robot, self._bank, self._believed, keys, rows, is_first)
        self._reset_physics(count, begun.parameters)
        everyone = np.arange(self.num_envs)
        replaced = dataclasses.replace(begun.state, key=jax.random.clone(begun.state.key))  # in every row
        self._state, observation = self._compiled.restart(
            self._robot, replaced, begun.state, _truth(self._stepper.read()), everyone
        )
        self._held = np.tile(self._home_commands, (self.num_envs, 1))
        return _as_numpy(observation)

    def step(self, actions: Any) -> Transition:
        """One control period: residual and base to the motors, physics, sensors, reward."""
        planned, commands = self._compiled.command(
            self._robot, self._state, jnp.asarray(actions, self._state.control.residual.dtype)
        )
        self._held = np.asarray(commands)
        self._stepper.step(self._held, self._substeps)
        readout = self._stepper.read()
        outcome = self._compiled.observe(self._robot, planned, _truth(readout))
        self._state = outcome.state
        valid = np.array(readout.is_finite)
        terminated = np.asarray(outcome.is_lost) & valid
        truncated = np.asarray(outcome.is_over) & valid & ~terminated
        diverged = {} if valid.all() else self._evidence(np.flatnonzero(~valid), planned, readout)
        final = observation = _as_numpy(outcome.observation)
        ended = np.flatnonzero(terminated | truncated | ~valid)
        if len(ended):
            observation = self._start_again(ended, observation)
        return Transition(
            observation=observation,
            reward=np.where(valid, np.asarray(outcome.reward), 0.0).astype(np.float32),
            terminated=terminated,
            truncated=truncated,
            final_observation=final,
            valid=valid,
            metrics={name: np.where(valid, np.asarray(value), np.nan) for name, value in outcome.metrics.items()},
            diverged=diverged,
        )

    def step_physics(self) -> None:
        """Advance the physics alone by one control period, commands held: the bare rate to compare with."""
        self._stepper.step(self._held, self._substeps)

    @property
    def commands(self) -> np.ndarray:
        """(num_envs, num_cables) what the motors hold now [m]."""
        return np.asarray(self._state.control.command)

    @property
    def strand_tension(self) -> np.ndarray:
        """(num_envs, strands) [N]."""
        return self._stepper.read().strand_tension

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that a bitwise continuation needs."""
        episode = dict(vars(self._state))
        control, faults = vars(episode.pop("control")), vars(episode.pop("faults"))
        episode["key"] = jax.random.key_data(episode["key"])
        parts = {"episode": episode, "control": control, "faults": faults, "physics": self._stepper.get_state()}
        return {f"{part}/{name}": np.array(value) for part, values in parts.items() for name, value in values.items()}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go back to what `get_state` returned."""
        parts: dict[str, dict[str, Any]] = {"episode": {}, "control": {}, "faults": {}, "physics": {}}
        for name, value in state.items():
            part, _, rest = name.partition("/")
            parts[part][rest] = value if part == "physics" else jnp.asarray(value)
        own = parts["episode"] | {"key": jax.random.wrap_key_data(parts["episode"]["key"])}
        faults = Faults(**parts["faults"])
        self._state = EpisodeState(control=ControlState(**parts["control"]), faults=faults, **own)
        self._held = np.asarray(jax.vmap(partial(strand_commands, self._robot))(faults.held))
        self._stepper.set_state(parts["physics"])

    def _evidence(self, ids: np.ndarray, planned: EpisodeState, readout: Readout) -> dict[str, np.ndarray]:
        """What arms `ids` were doing when they diverged: state, commands, parameters, the row of each an arm."""
        own, physics = planned.control, self._stepper.get_state()
        control = {"target": own.target, "base_lengths": own.base_lengths, "command": own.command, "step": own.step}
        parts = {
            "state": vars(readout),
            "control": control,
            "parameters": {field.name: physics[field.name] for field in dataclasses.fields(PhysicalParameters)},
        }
        rows = {
            f"{part}/{name}": np.array(value)[ids] for part, values in parts.items() for name, value in values.items()
        }
        return {"copy": ids, "strand_commands": self._held[ids], **rows}

    def _start_again(self, ids: np.ndarray, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """New episodes for arms `ids`; the observation of the others stays."""
        padded = np.resize(ids, _padded_size(len(ids), self.num_envs))  # repeats ids: few sizes to compile
        rows = np.full(len(padded), -1) if self._rows is None else np.asarray(self._rows)[padded]
        not_first = np.zeros(len(padded), bool)
        begun = self._compiled.begin(self._robot, self._bank, self._believed, self._state.key[padded], rows, not_first)
        self._reset_physics(ids, {name: value[: len(ids)] for name, value in _as_numpy(begun.parameters).items()})
        self._state, first = self._compiled.restart(
            self._robot, self._state, begun.state, _truth(self._stepper.read()), padded
        )
        changed = {key: value.copy() for key, value in observation.items()}
        for key, value in _as_numpy(first).items():
            changed[key][ids] = value[: len(ids)]
        return changed

    def _reset_physics(self, ids: np.ndarray, parameters: Mapping[str, Any]) -> None:
        values = PhysicalParameters(**{name: np.asarray(value) for name, value in parameters.items()})
        self._stepper.reset(ids, self._home, self._home_commands, values)


@dataclasses.dataclass(frozen=True)
class _Compiled:
    """The environment's pure functions over many arms; compiled once for all environments of a configuration."""

    begin: Callable[..., Any]
    restart: Callable[..., Any]
    command: Callable[..., Any]
    observe: Callable[..., Any]


@cache
def _compile(config: EnvironmentConfig) -> _Compiled:
    """What is drawn matters to `begin` alone, but for the encoders' noise: other ranges compile nothing else again."""
    begin = _compile_begin(EnvironmentConfig(**{name: getattr(config, name) for name in _BEGINS_WITH}))
    same = RandomisationConfig(encoder_noise_deg=config.randomisation.encoder_noise_deg)
    if config.randomisation != same:
        return dataclasses.replace(_compile(dataclasses.replace(config, randomisation=same)), begin=begin)
    return _Compiled(
        begin=begin,
        restart=jax.jit(partial(_restart_some, jax.vmap(partial(episode.restart, config), in_axes=(None, 0, 0)))),
        command=jax.jit(jax.vmap(partial(episode.command, config), in_axes=(None, 0, 0))),
        observe=jax.jit(jax.vmap(partial(episode.observe, config), in_axes=(None, 0, 0))),
    )


# All that `episode.begin` asks of its configuration: the others compile nothing again.
_BEGINS_WITH = (
    "episode_steps",
    "control_period",
    "latest_arrival",
    "scored_time",
    "dither",
    "residual",
    "randomisation",
)


@cache
def _compile_begin(config: EnvironmentConfig) -> Callable[..., Any]:
    return jax.jit(jax.vmap(partial(episode.begin, config), in_axes=(None, None, None, 0, 0, 0)))


def _restart_some(restart, robot: Robot, states: EpisodeState, fresh: EpisodeState, truth: TrueState, ids: jax.Array):
    """`_restart` for simulations `ids` among all; the states of the others stay."""
    fresh, first = restart(robot, fresh, jax.tree.map(lambda value: value[ids], truth))
    return jax.tree.map(lambda old, new: old.at[ids].set(new), states, fresh), first


def _truth(readout: Readout) -> TrueState:
    """What the observations need of a readout; jit copies the live arrays when it is called."""
    return TrueState(
        **{field.name: getattr(readout, field.name) for field in dataclasses.fields(TrueState)}  # pyright: ignore[reportArgumentType]
    )


def _as_numpy(arrays: Mapping[str, jax.Array]) -> dict[str, np.ndarray]:
    return {name: np.asarray(value) for name, value in arrays.items()}


def _padded_size(count: int, largest: int) -> int:
    """The next power of two, at least 8."""
    return min(largest, max(8, 2 ** math.ceil(math.log2(count))))
