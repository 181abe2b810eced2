"""One iteration as compiled programs: collect a rollout with the policy, then learn from it; or a round of DAgger.

Collecting and learning are two programs on a CPU, since XLA's options are per program: the physics needs its fusion pass
off (see `xla_options`), the update wants it on. On other devices they are one, `iterate`.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from qjrl.keys import key_for
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import ACTOR_KEY, CRITIC_KEY, Env, observation_sizes
from qjrl.learning.ppo.episodes import EpisodeLog, empty_log
from qjrl.learning.ppo.mesh import ENVS
from qjrl.learning.ppo.networks import initial_parameters, make_networks
from qjrl.learning.ppo.normaliser import Normaliser, initial_normaliser, update_normaliser
from qjrl.learning.ppo.rollout import Collected, Rollout, acting, collect
from qjrl.learning.ppo.trainer_state import TrainerState
from qjrl.learning.ppo.update import make_learner, make_update

Metrics = dict[str, jax.Array]
Experience = tuple[Rollout, Any]
"""A rollout, and the critic's observation (envs, m) after it."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What the programs of a training are compiled for; equal plans share them."""

    config: PPOConfig
    num_envs: int
    """Over all processes."""
    num_iterations: int
    mesh: Mesh
    sizes: tuple[tuple[str, int], ...]
    """Names of observations and their sizes."""
    action_size: int

    @functools.cached_property
    def networks(self) -> Any:
        """Actor and critic. Kept, so their constants must not belong to the program that asks first."""
        sizes = {name: dict(self.sizes)[name] for name in (ACTOR_KEY, CRITIC_KEY)}
        with jax.ensure_compile_time_eval():
            return make_networks(self.config, sizes, self.action_size)


def make_plan(env: Env, config: PPOConfig, num_envs: int, num_iterations: int, mesh: Mesh) -> Plan:
    """The plan of a training."""
    return Plan(config, num_envs, num_iterations, mesh, tuple(observation_sizes(env).items()), env.action_size)


def begin(plan: Plan, env: Env, seed: int) -> TrainerState:
    """The untrained state, the envs spread over the phases of an episode where `env` knows how."""
    sizes = {name: dict(plan.sizes)[name] for name in (ACTOR_KEY, CRITIC_KEY)}
    key = key_for(seed, "training arms")
    keys = jax.vmap(functools.partial(jax.random.fold_in, key))(jnp.arange(plan.num_envs))
    on_each_device = jax.shard_map(
        lambda env, keys: getattr(env, "spread", env.reset)(keys),
        mesh=plan.mesh,
        in_specs=(P(), P(ENVS)),  # an env that is closed over keeps the devices of outside, which gathers refuse
        out_specs=P(ENVS),
        check_vma=False,
    )
    envs = on_each_device(env, keys)
    parameters = initial_parameters(
        plan.networks, plan.config.initial_std, key_for(seed, "networks"), plan.config.starts_at_zero
    )
    return TrainerState(
        learner=make_learner(plan.config, parameters),
        normaliser=initial_normaliser(sizes),
        key=key_for(seed, "actions and minibatches"),
        iteration=jnp.int32(0),
        env_steps=jnp.uint32(0),
        envs=envs,
        episodes=empty_log(plan.num_envs, envs.metrics),
    )


def collecting(plan: Plan, env: Env, trainer: TrainerState, around: jax.Array) -> tuple[TrainerState, Experience]:
    """The state with its envs further on, and a rollout of the actor.

    Args:
        around: below 0, the actor explores as PPO does. Otherwise it acts deterministically, and one draw of normal noise
            of this standard deviation is added at all steps, as DAgger does.
    """
    key_actions, key = jax.random.split(trainer.key)
    shape = (plan.config.unroll_length, plan.num_envs, plan.action_size)
    noise = jax.random.normal(key_actions, shape, jnp.float32)
    noise = jnp.where(around < 0.0, noise, around * noise[:1])

    def local(env: Env, learnt: Any, state: Any, episodes: EpisodeLog, noise: jax.Array) -> Collected:
        parameters, normaliser, around = learnt
        act = acting(plan.networks, parameters["policy"], normaliser, around >= 0.0)
        critic = functools.partial(plan.networks.value_network.apply, normaliser, parameters["value"])
        return collect(env, act, lambda rows: critic({CRITIC_KEY: rows}), state, episodes, noise)

    rows, steps = P(ENVS), P(None, ENVS)
    outputs = Collected(rollout=steps, state=rows, last_observation=rows, episodes=rows)  # pyright: ignore[reportArgumentType]
    on_each_device = jax.shard_map(
        local, mesh=plan.mesh, in_specs=(P(), P(), rows, rows, steps), out_specs=outputs, check_vma=False
    )
    learnt = trainer.learner.parameters, trainer.normaliser, around
    collected = on_each_device(env, learnt, trainer.envs, trainer.episodes, noise)
    trainer = dataclasses.replace(trainer, key=key, envs=collected.state, episodes=collected.episodes)
    return trainer, (collected.rollout, collected.last_observation)


def learning(plan: Plan, trainer: TrainerState, experience: Experience) -> tuple[TrainerState, Metrics]:
    """The state after learning from what `collecting` gave, and its metrics.

    Learn with the statistics that the rollout was acted with, then take its observations into them. New statistics move
    the policy by themselves: taken in first, they looked like a divergence of 0.02 and drove the adaptive rate to its floor
    (measured on the residual environment). An untrained actor ignores its observation, so the first rollout can be, and is,
    taken in before anything is learned.
    """
    config, (rollout, last_observation) = plan.config, experience
    key_update, key = jax.random.split(trainer.key)
    seen = {name: rollout.observation[name] for name in (ACTOR_KEY, CRITIC_KEY)}
    updated = update_normaliser(trainer.normaliser, seen, rollout.valid)
    is_first = trainer.iteration == 0
    normaliser = jax.tree.map(lambda new, old: jnp.where(is_first, new, old), updated, trainer.normaliser)
    learner = trainer.learner
    if config.learning_rate_schedule == "linear":
        rate = config.learning_rate * (1.0 - trainer.iteration / plan.num_iterations)
        learner = dataclasses.replace(learner, learning_rate=rate.astype(jnp.float32))
    rounds = config.dagger.rounds
    moves_actor = (trainer.iteration >= rounds + config.critic_warmup) | (rounds == 0)
    update = make_update(plan.networks, config, plan.mesh)
    learner, losses = update(
        learner, normaliser, dataclasses.replace(rollout, observation=seen), last_observation, key_update, moves_actor
    )
    metrics = losses | _counts(rollout) | {f"log/{name}": value for name, value in trainer.episodes.totals().items()}
    return (
        dataclasses.replace(
            trainer,
            learner=learner,
            normaliser=updated,
            key=key,
            iteration=trainer.iteration + jnp.int32(1),
            env_steps=trainer.env_steps + jnp.uint32(rollout.reward.size),
            episodes=trainer.episodes.cleared(),
        ),
        metrics,
    )


def iterate(plan: Plan, env: Env, trainer: TrainerState) -> tuple[TrainerState, Metrics]:
    """A whole iteration of PPO: what an accelerator runs."""
    return learning(plan, *collecting(plan, env, trainer, jnp.float32(EXPLORES)))


def storing(plan: Plan, normaliser: Normaliser, rollout: Rollout) -> tuple[Normaliser, Rollout, Metrics]:
    """Of a rollout of DAgger: the statistics with the stored steps in them, these steps, and what diverged in all."""
    stored = jax.tree.map(lambda rows: rows[:: plan.config.dagger.every], rollout)
    seen = {name: stored.observation[name] for name in (ACTOR_KEY, CRITIC_KEY)}
    return update_normaliser(normaliser, seen, stored.valid), stored, _counts(rollout)


EXPLORES = -1.0
"""What `collecting` takes as `around` for PPO."""


def _counts(rollout: Rollout) -> Metrics:
    return {
        "num_valid": jnp.sum(rollout.valid),
        "num_steps": jnp.int32(rollout.valid.size),
        "reward_sum": jnp.sum(rollout.reward),
    }
