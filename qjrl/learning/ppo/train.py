"""The PPO loop: iterate, evaluate, write down; it goes on where it stopped. The host sees iterations."""

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl import artifacts, progress
from qjrl.config import as_mapping
from qjrl.learning.ppo import mesh as meshes
from qjrl.learning.ppo.checkpointer import Checkpointer, Evaluate, open_checkpointer
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.dagger import deviation, fit_round
from qjrl.learning.ppo.environment import ACTOR_KEY, EXPERT_KEY, Env, observation_sizes
from qjrl.learning.ppo.iteration import Plan, make_plan
from qjrl.learning.ppo.policy import Policy, moderated
from qjrl.learning.ppo.programs import Programs, make_programs
from qjrl.learning.ppo.records import Record, check_losses, check_validity, note_of, record_of, validity_of
from qjrl.learning.ppo.trainer_state import TrainerState, policy_of


def train(
    env: Env,
    config: PPOConfig,
    num_envs: int,
    seed: int,
    directory: Path,
    evaluate: Evaluate | None = None,
    minimise: str | None = None,
    callbacks: Iterable[Callable[[Record], None]] = (),
) -> Policy:
    """Trains a policy; an interrupted training in the same directory goes on, bit for bit.

    The envs are dealt out over all devices; several processes of JAX's distributed runtime train one policy together: what
    a process alone trains, up to the order of sums. The first alone writes; another number of processes can go on.

    Args:
        num_envs: over all processes, a multiple of the devices.
        directory: gets `checkpoints/`, `progress.jsonl`, and the policy kept so far as `policy.npz` and `policy.json`;
            `diverged.npz`, where too many steps are invalid.
        evaluate: metrics of the deterministic policy, asked for before the first iteration and at every checkpoint, in the
            first process alone; in the records they are called `evaluation/NAME`.
        minimise: the metric of `evaluate` by which the policy to keep is chosen; None: the latest is kept.
        callbacks: called with every record of `progress.jsonl`.
    Returns:
        The policy kept.
    Raises:
        TrainingDiverged: too many invalid steps, or a loss that is not finite.
        ArtifactError: the directory holds another training.
    """
    mesh, is_double = meshes.device_mesh(), jax.config.jax_enable_x64

    def evaluated(policy: Policy) -> Mapping[str, float | None]:
        with jax.enable_x64(is_double):  # as the caller computes
            return evaluate(policy) if evaluate else {}

    with jax.enable_x64(False):  # also around the look at the environment: Warp insists on float32
        sizes = _sizes(config, env, num_envs)
        identity = artifacts.hash_of([as_mapping(config), [num_envs, env.action_size, observation_sizes(env)], seed])
        plan = make_plan(env, config, num_envs, len(sizes), mesh)
        env = meshes.everywhere(mesh, env)
        programs = make_programs(plan)
        trainer = programs.begin(env, np.uint32(seed))
        with open_checkpointer(
            directory, identity, config, mesh, evaluated if evaluate else None, minimise, list(callbacks)
        ) as checkpointer:
            trainer, is_new = checkpointer.begin(trainer)
            if is_new:
                checkpointer.keep(trainer, {"iteration": 0, "env_steps": 0})
            already = int(trainer.env_steps)
            with progress.track(sum(sizes), "policy", already=already) as advance, checkpointer.evidence():
                trainer = _run(plan, programs, env, trainer, sizes, checkpointer, advance)
            return checkpointer.policy(trainer)


def _run(
    plan: Plan,
    programs: Programs,
    env: Env,
    trainer: TrainerState,
    sizes: list[int],
    checkpointer: Checkpointer,
    advance: Callable[..., None],
) -> TrainerState:
    config = plan.config
    for iteration in range(int(trainer.iteration) + 1, len(sizes) + 1):
        is_dagger = iteration <= config.dagger.rounds
        if is_dagger:
            trainer, record = run_dagger(plan, programs, env, trainer, advance)
        else:
            trainer, record = run_iteration(plan, programs, env, trainer)
        due = is_dagger or iteration % config.checkpoint_every == 0 or iteration == len(sizes)
        checkpointer.keep(trainer, record) if due else checkpointer.write(record)
        advance(0 if is_dagger else sizes[iteration - 1], note=note_of(record))
    return trainer


def run_iteration(plan: Plan, programs: Programs, env: Env, trainer: TrainerState) -> tuple[TrainerState, Record]:
    """One iteration of PPO.

    Returns:
        The state after it, and its record for the log.
    Raises:
        TrainingDiverged: too many invalid steps, or a loss that is not finite.
    """
    start = time.perf_counter()
    iterated = programs.run_iteration(env, trainer)
    record = record_of(meshes.on_host(iterated.metrics))  # waits for the devices
    seconds = time.perf_counter() - start
    following, iteration = iterated.trainer, int(iterated.trainer.iteration)
    check_validity(record, iteration, plan.config, iterated.replay)
    check_losses(record, iteration)
    times = {"steps_per_second": round(plan.config.unroll_length * plan.num_envs / seconds, 1)}
    if (collecting := iterated.collecting_seconds) is not None:
        times |= {"collecting_seconds": round(collecting, 4), "learning_seconds": round(seconds - collecting, 4)}
    return following, {"iteration": iteration, "env_steps": int(following.env_steps)} | record | times


def run_dagger(
    plan: Plan, programs: Programs, env: Env, trainer: TrainerState, advance: Callable[..., None]
) -> tuple[TrainerState, Record]:
    """One round of DAgger as an iteration, before those of PPO.

    Args:
        advance: called with the number of environment steps made: a round takes a while.
    Returns:
        The state after it, and its record for the log.
    Raises:
        TrainingDiverged: too many invalid steps.
    """
    start, config, number = time.perf_counter(), plan.config.dagger, int(trainer.iteration)
    around, pieces = deviation(config, number), _num_rollouts(plan.config)
    policy, statistics, rows, num_valid, worst = policy_of(trainer, plan.config), trainer.normaliser, [], 0, None
    for _ in range(pieces):
        before = trainer
        trainer, (rollout, _) = programs.collect(env, before, np.float32(around))
        statistics, stored, counts = programs.store(statistics, rollout)
        seen, expert = (meshes.on_host(stored.observation[name]) for name in (ACTOR_KEY, EXPERT_KEY))
        sound = meshes.on_host(stored.valid)
        rows.append((seen[sound], expert[sound]))
        sound_steps = int(meshes.on_host(counts["num_valid"]))
        num_valid += sound_steps
        worst = before if worst is None and sound_steps < plan.config.unroll_length * plan.num_envs else worst
        advance(sound.shape[1] * plan.config.unroll_length)
    num_steps = pieces * plan.config.unroll_length * plan.num_envs
    record = validity_of(num_valid, num_steps)
    replay = lambda: programs.replay(env, worst, around) if worst is not None else {}  # noqa: E731
    check_validity(record, number + 1, plan.config, replay)
    mean, std = meshes.on_host((_of(statistics.mean), _of(statistics.std)))
    policy = dataclasses.replace(policy, mean=mean, std=std)
    key_fit, key = jax.random.split(trainer.key)
    columns = np.concatenate([row[0] for row in rows]), np.concatenate([row[1] for row in rows])
    policy, loss = fit_round(policy, config, number, columns, key_fit)
    if number == config.rounds - 1:
        policy = moderated(policy, config.share)
    layers = meshes.everywhere(plan.mesh, {"params": dict(policy.layers)})
    learner = dataclasses.replace(trainer.learner, parameters=trainer.learner.parameters | {"policy": layers})
    trainer = dataclasses.replace(
        trainer,
        learner=learner,
        normaliser=statistics,
        key=key,
        iteration=trainer.iteration + jnp.int32(1),
        env_steps=trainer.env_steps + jnp.uint32(num_steps),
        episodes=trainer.episodes.cleared(),
    )
    seconds = time.perf_counter() - start
    times = {"dagger_seconds": round(seconds, 2), "dagger_steps_per_second": round(num_steps / seconds, 1)}
    counts = {"iteration": number + 1, "env_steps": int(trainer.env_steps)}
    return trainer, counts | record | {"dagger_loss": loss} | times


def _sizes(config: PPOConfig, env: Env, num_envs: int) -> list[int]:
    """Environment steps of every iteration: the rounds of DAgger, then those of PPO."""
    if num_envs % jax.device_count():
        raise ValueError(f"num_envs: got {num_envs}, allowed: a multiple of the {jax.device_count()} devices")
    if config.dagger.rounds > 0 and EXPERT_KEY not in observation_sizes(env):
        raise ValueError(f"dagger.rounds: got {config.dagger.rounds}, allowed: 0, this environment knows no expert")
    per_iteration = config.unroll_length * num_envs
    if per_iteration < config.num_minibatches:
        steps = f"unroll_length {config.unroll_length} x {num_envs} envs"
        raise ValueError(f"num_minibatches: got {config.num_minibatches}, allowed: at most {per_iteration} ({steps})")
    rounds = [_num_rollouts(config) * per_iteration] * config.dagger.rounds
    return rounds + [per_iteration] * -(-config.num_steps // per_iteration)


def _of(statistics: Any) -> Any:
    """The actor's part of an observation's statistics."""
    return statistics[ACTOR_KEY]


def _num_rollouts(config: PPOConfig) -> int:
    """Rollouts in a round of DAgger."""
    return -(-config.dagger.steps // config.unroll_length)
