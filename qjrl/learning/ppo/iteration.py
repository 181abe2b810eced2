"""One iteration of PPO, step by step: collect, take in the statistics, value what was cut off, update."""

import dataclasses
import functools
import math
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.learning import processes
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo import sharding
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import CRITIC_KEY, VectorEnv, num_copies
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.imitation import Imitated, imitate
from qjrl.learning.ppo.networks import initial_parameters, make_networks
from qjrl.learning.ppo.normaliser import update_normaliser
from qjrl.learning.ppo.rollout import Collected, Rollout, collect, make_act
from qjrl.learning.ppo.training_state import Session, TrainingState, policy_of
from qjrl.learning.ppo.update import make_update

Record = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Compiled:
    """The compiled functions of a training."""

    initialise: Callable[[jax.Array], Any]
    act: Callable[..., Any]
    place: Callable[[Rollout], Rollout]
    """Puts a rollout where the two updates want it."""
    update_normaliser: Callable[..., Any]
    value: Callable[..., jax.Array]
    update: Callable[..., Any]


def compile_functions(config: PPOConfig, environment: VectorEnv) -> Compiled:
    """The same functions for the same configuration and sizes, so that the jobs of a sweep compile once.

    Compilation itself happens at the first call of each.
    """
    return _compile_functions(config, tuple(environment.observation_sizes.items()), environment.action_size)


@functools.cache
def _compile_functions(config: PPOConfig, sizes: tuple[tuple[str, int], ...], action_size: int) -> Compiled:
    networks = make_networks(config, dict(sizes), action_size)
    place, take_in, update = jax.device_put, jax.jit(update_normaliser), make_update(networks, config)
    if jax.device_count() > 1:  # the updates cut the rollout themselves
        mesh = sharding.device_mesh()
        place, take_in, update = lambda it: it, sharding.normaliser_on(mesh, take_in), sharding.update_on(mesh, update)
    return Compiled(
        initialise=jax.jit(lambda key: initial_parameters(networks, config.initial_std, key, config.starts_at_zero)),
        act=make_act(networks),
        place=place,
        update_normaliser=take_in,
        value=jax.jit(networks.value_network.apply),
        update=update,
    )


def run_iteration(
    session: Session, compiled: Compiled, config: PPOConfig, num_iterations: int
) -> tuple[Session, Record]:
    """Collects one rollout and learns from it; of several processes each collects its own, and all learn the same.

    Returns:
        The session after it, and its record for the log.
    Raises:
        TrainingDiverged: too many invalid steps, or a loss that is not finite.
    """
    start = time.perf_counter()
    state = session.state
    key_actions, key_update, key_next = jax.random.split(state.key, 3)
    collected = _collect(session, compiled, config, key_actions)
    record = session.episodes.summary() | _reward_record(collected.rollout)
    collecting = time.perf_counter() - start
    _check_validity(record, int(state.iteration) + 1, config, collected.diverged)
    state, losses = _learn(state, collected, compiled, config, num_iterations, key_update)
    state = dataclasses.replace(state, key=key_next)
    record |= {name: float(value) for name, value in losses.items()}  # waits for the device
    _check_losses(record, int(state.iteration))
    counts = {"iteration": int(state.iteration), "env_steps": int(state.env_steps)}
    times = _times(time.perf_counter() - start, collecting, collected)
    session = dataclasses.replace(session, state=state, observation=collected.observation)
    return session, counts | record | times


def run_imitation(
    session: Session, compiled: Compiled, config: PPOConfig, seed: int, advance: Callable[[int], None]
) -> tuple[Session, Record]:
    """One round of imitation as an iteration, before those of PPO.

    Args:
        advance: called with the number of environment steps made: a round takes a minute.
    Returns:
        The session after it, and its record for the log.
    Raises:
        TrainingDiverged: too many invalid steps.
    """
    start, state, environment = time.perf_counter(), session.state, session.environment
    before = Imitated(policy_of(state, config), state.normaliser, session.observation)
    found = imitate(
        environment, config.imitation, int(state.iteration), before, compiled.update_normaliser, seed, advance
    )
    num_steps = config.imitation.steps * num_copies(environment)
    record = _validity(num_steps - int(processes.total(found.num_invalid)), num_steps)
    _check_validity(record, int(state.iteration) + 1, config, found.diverged)
    parameters = state.learner.parameters | {"policy": {"params": jax.tree.map(jnp.asarray, found.policy.layers)}}
    state = dataclasses.replace(
        state,
        learner=dataclasses.replace(state.learner, parameters=parameters),
        normaliser=found.normaliser,
        iteration=state.iteration + jnp.int32(1),
        env_steps=state.env_steps + jnp.uint32(num_steps),
    )
    seconds = time.perf_counter() - start
    record |= {
        "iteration": int(state.iteration),
        "env_steps": int(state.env_steps),
        "imitation_loss": found.loss,
        "imitation_seconds": round(seconds, 2),
        "imitation_steps_per_second": round(num_steps / seconds, 1),
    }
    state = jax.device_put(state, jax.local_devices()[0])
    episodes = EpisodeLog(environment.num_envs)
    return dataclasses.replace(session, state=state, observation=found.observation, episodes=episodes), record


def _collect(session: Session, compiled: Compiled, config: PPOConfig, key: jax.Array) -> Collected:
    state = session.state
    parameters = state.learner.parameters["policy"]

    def act(observation: Any, step: int) -> Any:
        return compiled.act(parameters, state.normaliser, observation, key, step)

    return collect(session.environment, act, session.observation, config.unroll_length, session.episodes)


def _learn(
    state: TrainingState,
    collected: Collected,
    compiled: Compiled,
    config: PPOConfig,
    num_iterations: int,
    key: jax.Array,
) -> tuple[TrainingState, dict[str, Any]]:
    """Learn with the statistics that the rollout was acted with, then take its observations into them.

    New statistics move the policy by themselves: taken in first, they looked like a divergence of 0.02 and drove the
    adaptive rate to its floor (measured on the residual environment). An untrained actor ignores its observation, so
    the first rollout can be, and is, taken in before anything is learned.
    """
    rollout = compiled.place(collected.rollout)
    updated = compiled.update_normaliser(state.normaliser, rollout.observation, rollout.valid)
    normaliser = updated if int(state.iteration) == 0 else state.normaliser
    final_values = value_of_cut_off(compiled.value, normaliser, state.learner.parameters["value"], collected)
    learner = state.learner
    if config.learning_rate_schedule == "linear":
        rate = config.learning_rate * (1 - int(state.iteration) / num_iterations)
        learner = dataclasses.replace(learner, learning_rate=jnp.float32(rate))
    rounds = config.imitation.rounds
    moves_actor = jnp.bool_(rounds == 0 or int(state.iteration) >= rounds + config.critic_warmup)
    learner, losses = compiled.update(learner, normaliser, rollout, final_values, key, moves_actor)
    state = dataclasses.replace(
        state,
        learner=learner,
        normaliser=updated,
        iteration=state.iteration + jnp.int32(1),
        env_steps=state.env_steps + jnp.uint32(collected.rollout.reward.size * jax.process_count()),
    )
    return state, losses


def value_of_cut_off(value: Callable[..., Any], normaliser: Any, parameters: Any, collected: Collected) -> np.ndarray:
    """(steps, envs) float32: the critic's value of the final observation where an episode was truncated, else 0."""
    num_steps, num_envs = collected.rollout.reward.shape
    values = np.zeros((num_steps, num_envs), np.float32)
    num_rows = len(collected.final_rows)
    if num_rows:
        # Whole multiples of the number of environments, so that few shapes are ever compiled.
        room = -(-num_rows // num_envs) * num_envs
        rows = np.pad(collected.final_rows, ((0, room - num_rows), (0, 0)))
        values[collected.final_places] = np.asarray(value(normaliser, parameters, {CRITIC_KEY: rows}))[:num_rows]
    return values


def _reward_record(rollout: Rollout) -> Record:
    """Over the rollouts of all processes, so that all of them stop where one must."""
    num_valid, num_steps = int(processes.total(rollout.valid.sum())), rollout.valid.size * jax.process_count()
    reward = processes.total(rollout.reward.sum(dtype=np.float64)) / num_valid if num_valid else None
    return {"reward": reward} | _validity(num_valid, num_steps)


def _validity(num_valid: int, num_steps: int) -> Record:
    return {"invalid": num_steps - num_valid, "invalid_fraction": 1 - num_valid / num_steps}


def _check_validity(record: Record, iteration: int, config: PPOConfig, diverged: dict[str, np.ndarray]) -> None:
    if record["invalid_fraction"] > config.max_invalid_fraction:
        raise TrainingDiverged(
            f"iteration {iteration}: {record['invalid_fraction']:.1%} of the steps diverged or were not finite, "
            f"allowed: {config.max_invalid_fraction:.1%} (max_invalid_fraction)",
            diverged,
        )


def _check_losses(record: Record, iteration: int) -> None:
    broken = [name for name in ("policy_loss", "value_loss", "entropy", "kl") if not math.isfinite(record[name])]
    if broken:
        raise TrainingDiverged(f"iteration {iteration}: {', '.join(broken)} not finite; try a smaller learning_rate")


def _times(total: float, collecting: float, collected: Collected) -> Record:
    """Where the time of an iteration went, in seconds; `act` is what collecting took beside the environment."""
    return {
        "steps_per_second": round(collected.rollout.reward.size * jax.process_count() / total, 1),
        "environment_seconds": round(collected.environment_seconds, 4),
        "act_seconds": round(collecting - collected.environment_seconds, 4),
        "learning_seconds": round(total - collecting, 4),
    }
