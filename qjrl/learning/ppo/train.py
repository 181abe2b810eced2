"""The PPO loop: iterate, evaluate, write down; it goes on where it stopped."""

from collections.abc import Callable, Iterable
from pathlib import Path

import jax

from qjrl import artifacts, progress
from qjrl.config import as_mapping
from qjrl.learning.ppo.books import Evaluate, open_books
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import VectorEnv, num_copies
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.iteration import Record, compile_functions, run_imitation, run_iteration
from qjrl.learning.ppo.policy import Policy
from qjrl.learning.ppo.training_state import Session, initial_state


def train(
    environment: VectorEnv,
    config: PPOConfig,
    seed: int,
    directory: Path,
    evaluate: Evaluate | None = None,
    minimise: str | None = None,
    callbacks: Iterable[Callable[[Record], None]] = (),
) -> Policy:
    """Trains a policy; an interrupted training in the same directory goes on, bit for bit.

    Several processes of JAX's distributed runtime, each with as many copies of the environment, train one policy: what a
    process alone with all the copies trains, up to the order of sums. The first keeps the books and gives the others
    their parts of a checkpoint; another number of processes can go on with a training.

    Args:
        environment: reset here, or set back to the state of the latest checkpoint.
        directory: gets `checkpoints/`, `progress.jsonl`, and the policy kept so far as `policy.npz` and `policy.json`;
            `diverged.npz`, where too many steps are invalid and the environment knows what the copies were doing.
        evaluate: metrics of the deterministic policy, asked for before the first iteration and at every checkpoint, in the
            first process alone; in the records they are called `evaluation/NAME`. It must leave `environment` as it was.
        minimise: the metric of `evaluate` by which the policy to keep is chosen; None: the latest is kept.
        callbacks: called with every record of `progress.jsonl`.
    Returns:
        The policy kept.
    Raises:
        TrainingDiverged: too many invalid steps, or a loss that is not finite.
        ArtifactError: the directory holds another training.
    """
    sizes = _sizes(config, environment)
    with progress.compiling("the policy and its update"):
        compiled = compile_functions(config, environment)
    identity = _identity(config, environment, seed)
    state = initial_state(compiled.initialise, config, environment, seed)
    session = Session(state, environment.reset(), environment, EpisodeLog(environment.num_envs))
    with open_books(directory, identity, config, evaluate, minimise, list(callbacks)) as books:
        session, is_new = books.begin(session)
        if is_new:
            books.keep(session, {"iteration": 0, "env_steps": 0})
        done, already = int(session.state.iteration), int(session.state.env_steps)
        with progress.track(sum(sizes), "policy", already=already) as advance, books.evidence():
            for iteration in range(done + 1, len(sizes) + 1):
                is_imitation = iteration <= config.imitation.rounds
                if is_imitation:
                    session, record = run_imitation(session, compiled, config, seed, advance)
                else:
                    session, record = run_iteration(session, compiled, config, len(sizes))
                due = is_imitation or iteration % config.checkpoint_every == 0 or iteration == len(sizes)
                books.keep(session, record) if due else books.write(record)
                advance(0 if is_imitation else sizes[iteration - 1], note=_note(record))
        return books.policy(session)


def _sizes(config: PPOConfig, environment: VectorEnv) -> list[int]:
    """Environment steps of every iteration: the rounds of imitation, then those of PPO."""
    rounds, devices, copies = config.imitation.rounds, jax.local_device_count(), num_copies(environment)
    if rounds > 0 and not environment.gives_advice:
        raise ValueError(f"imitation.rounds: got {rounds}, allowed: 0, this environment gives no advice")
    if environment.num_envs % devices:
        raise ValueError(f"num_envs: got {environment.num_envs}, allowed: a multiple of the {devices} devices")
    per_iteration = config.unroll_length * copies
    if per_iteration < config.num_minibatches:
        steps = f"unroll_length {config.unroll_length} x {copies} environments"
        raise ValueError(f"num_minibatches: got {config.num_minibatches}, allowed: at most {per_iteration} ({steps})")
    imitation = [config.imitation.steps * copies] * rounds
    return imitation + [per_iteration] * -(-config.num_steps // per_iteration)


def _identity(config: PPOConfig, environment: VectorEnv, seed: int) -> str:
    sizes = [num_copies(environment), environment.action_size, environment.observation_sizes]
    return artifacts.hash_of([as_mapping(config), sizes, seed])


def _note(record: Record) -> str:
    shown = ((name, record.get(name)) for name in ("return", "reward", "std", "kl"))
    return ", ".join(f"{name} {value:.3g}" for name, value in shown if value is not None)
