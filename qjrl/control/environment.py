"""The residual environment: many arms, each reaching one target with a base controller and a learned residual.

Pure functions of one pytree around those of `episode`; the physics is an engine's. Episodes end by the time limit
(truncation) unless the arm is lost (termination). A diverged simulation is invalid and begins anew. Every episode has an
arm of its own: its parameters are drawn when it begins, and are part of the state.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.control import episode
from qjrl.control.controller import Task
from qjrl.control.episode import Bank, EnvironmentConfig, EpisodeState, tasks_of
from qjrl.control.motors import action_size
from qjrl.learning.ppo.environment import State
from qjrl.learning.some_rows import for_some_rows
from qjrl.robot import in_precision
from qjrl.robot.plant import PlantState
from qjrl.robot.verbs import Robot
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.engine import Engine


@struct.dataclass
class Arms:
    """The environment's own state, a row an arm."""

    episode: EpisodeState
    plant: Any
    """The engine's."""


@struct.dataclass
class ResidualEnv:
    """An environment for PPO (`learning.ppo.environment.Env`); made by `residual_env`."""

    robot: Robot
    tasks: Task
    """A row a target of the bank."""
    engine: Engine
    config: EnvironmentConfig = struct.field(pytree_node=False)

    @property
    def action_size(self) -> int:
        """Numbers of an action."""
        return action_size(self.config.residual, self.robot)

    def reset(self, keys: jax.Array, are_cut: bool = False) -> State:
        """New episodes of as many arms as there are keys, at rest at home; cut short at random lengths, if asked for."""
        begin = partial(episode.begin, self.config, self.robot, self.tasks)
        rows, cut = jnp.full(len(keys), -1), jnp.full(len(keys), are_cut)
        begun = jax.vmap(begin)(keys, rows, cut)
        plant = self.engine.home(begun.parameters)
        restart = partial(episode.restart, self.config, self.robot)
        state, observation = jax.vmap(restart)(begun.state, self.engine.read(plant))
        zeros, never = jnp.zeros(len(keys), jnp.float32), jnp.zeros(len(keys), bool)
        return State(
            inner=Arms(state, plant),
            observation=observation,
            final_observation=observation,
            reward=zeros,
            terminated=never,
            truncated=never,
            valid=~never,
            metrics=dict.fromkeys(episode.METRICS, zeros),
        )

    def spread(self, keys: jax.Array) -> State:
        """As `reset`, the first episodes cut short so that the arms are spread over all phases of an episode."""
        return self.reset(keys, are_cut=True)

    def step(self, state: State, actions: jax.Array) -> State:
        """One control period: residual and base to the motors, physics, sensors, reward; ended episodes begin anew."""
        planned, commands = self.command(state.inner.episode, actions)
        substeps = substeps_of(self.config.control_period, self.engine.timestep)
        plant = self.engine.advance(state.inner.plant, commands, substeps)
        seen = self.engine.read(plant)
        outcome = self.observe(planned, seen)
        valid = seen.is_sound & _is_finite(outcome.observation) & jnp.isfinite(outcome.reward)
        terminated = outcome.is_lost & valid
        truncated = outcome.is_over & valid & ~terminated
        stepped = State(
            inner=Arms(outcome.state, plant),
            observation=outcome.observation,
            final_observation=outcome.observation,
            reward=jnp.where(valid, outcome.reward, 0.0).astype(jnp.float32),
            terminated=terminated,
            truncated=truncated,
            valid=valid,
            metrics={name: jnp.where(valid, value, jnp.nan) for name, value in outcome.metrics.items()},
        )
        return self._begin_anew(stepped, terminated | truncated | ~valid)

    def command(self, state: EpisodeState, actions: jax.Array) -> tuple[EpisodeState, jax.Array]:
        """The next states' commands, and the strands' rest lengths (arms, strands) [m]."""
        actions = actions.astype(state.control.residual.dtype)
        return jax.vmap(partial(episode.command, self.config, self.robot))(state, actions)

    def observe(self, planned: EpisodeState, seen: PlantState) -> episode.StepOutcome:
        """Sensors, feedback, reward and end of episode after the physics has moved."""
        return jax.vmap(partial(episode.observe, self.config, self.robot))(planned, seen)

    def _begin_anew(self, state: State, ended: jax.Array) -> State:
        def fresh(words: jax.Array) -> tuple[Arms, Any]:
            begun = self.reset(jax.random.wrap_key_data(words))
            return begun.inner, begun.observation

        words = jax.random.key_data(state.inner.episode.key)  # JAX's check of keys does not see that a row is used once
        inner, observation = for_some_rows(ended, fresh, words, (state.inner, state.observation))
        return state.replace(inner=inner, observation=observation)  # pyright: ignore[reportAttributeAccessIssue]


def residual_env(robot: Robot, config: EnvironmentConfig, bank: Bank, engine: Engine) -> ResidualEnv:
    """The environment, its numbers float32; what follows from a row of the bank alone is computed here, in float64.

    Raises:
        ConfigError: the control period is no multiple of the engine's time step.
    """
    substeps_of(config.control_period, engine.timestep)
    tasks = jax.tree.map(lambda values: jnp.asarray(values, jnp.float32), tasks_of(config, robot, bank))
    return ResidualEnv(in_precision(robot, "float32"), tasks, engine, config)


def _is_finite(observation: Any) -> jax.Array:
    """(n,) whether all numbers of a row are."""
    rows = jnp.concatenate(list(observation.values()), axis=1)
    return jnp.all(jnp.isfinite(rows), axis=1)
