"""The PPO loop: iterate, evaluate, write down; it goes on where it stopped."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import jax
import orbax.checkpoint as ocp

from qjrl import artifacts, progress
from qjrl.config import as_mapping
from qjrl.learning import checkpoints as ckpt
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import VectorEnv
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.iteration import Compiled, Record, compile_functions, run_imitation, run_iteration
from qjrl.learning.ppo.policy import Policy, load_policy, save_policy
from qjrl.learning.ppo.training_state import Session, initial_state, policy_of, restore_session, save_session

Evaluate = Callable[[Policy], Mapping[str, float | None]]

POLICY, PROGRESS, CHECKPOINTS, DIVERGED = "policy", "progress.jsonl", "checkpoints", "diverged.npz"


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

    Args:
        environment: reset here, or set back to the state of the latest checkpoint.
        directory: gets `checkpoints/`, `progress.jsonl`, and the policy kept so far as `policy.npz` and `policy.json`;
            `diverged.npz`, where too many steps are invalid and the environment knows what the copies were doing.
        evaluate: metrics of the deterministic policy, asked for before the first iteration and at every checkpoint;
            in the records they are called `evaluation/NAME`. It must leave `environment` as it was.
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
    callbacks = list(callbacks)

    def write(record: Record) -> None:
        artifacts.append_json_line(directory / PROGRESS, record)
        for callback in callbacks:
            callback(record)

    def keep(session: Session, record: Record) -> None:
        """Log first: after a crash in between, the resumed training writes the same line again."""
        metrics = None if evaluate is None else dict(evaluate(policy_of(session.state, config)))
        write(record | {f"evaluation/{name}": value for name, value in (metrics or {}).items()})
        save_session(checkpoints, session, metrics)
        _export_if_best(checkpoints, session, config, directory)

    with ckpt.open_checkpoints(directory / CHECKPOINTS, _identity(config, environment, seed), minimise) as checkpoints:
        session = _begin(checkpoints, compiled, config, environment, seed, directory)
        done = int(session.state.iteration)
        if checkpoints.latest_step() is None:
            keep(session, {"iteration": 0, "env_steps": 0})
        already = int(session.state.env_steps)
        with progress.track(sum(sizes), "policy", already=already) as advance:
            for iteration in range(done + 1, len(sizes) + 1):
                is_imitation = iteration <= config.imitation.rounds
                if is_imitation:
                    session, record = run_imitation(session, config, seed, advance)
                else:
                    with _evidence_in(directory):
                        session, record = run_iteration(session, compiled, config, len(sizes))
                due = is_imitation or iteration % config.checkpoint_every == 0 or iteration == len(sizes)
                keep(session, record) if due else write(record)
                advance(0 if is_imitation else sizes[iteration - 1], note=_note(record))
    return load_policy(directory / POLICY)


@contextmanager
def _evidence_in(directory: Path) -> Iterator[None]:
    """Writes what a `TrainingDiverged` knows into the directory, and names the file in its message."""
    try:
        yield
    except TrainingDiverged as error:
        if not error.evidence:
            raise
        path = directory / DIVERGED
        artifacts.write_arrays(path, error.evidence)
        raise TrainingDiverged(f"{error}; states, commands and parameters: {path}", error.evidence) from error


def _sizes(config: PPOConfig, environment: VectorEnv) -> list[int]:
    """Environment steps of every iteration: the rounds of imitation, then those of PPO."""
    rounds, devices = config.imitation.rounds, jax.local_device_count()
    if rounds > 0 and not environment.gives_advice:
        raise ValueError(f"imitation.rounds: got {rounds}, allowed: 0, this environment gives no advice")
    if environment.num_envs % devices:
        raise ValueError(f"num_envs: got {environment.num_envs}, allowed: a multiple of the {devices} devices")
    per_iteration = config.unroll_length * environment.num_envs
    if per_iteration < config.num_minibatches:
        steps = f"unroll_length {config.unroll_length} x {environment.num_envs} environments"
        raise ValueError(f"num_minibatches: got {config.num_minibatches}, allowed: at most {per_iteration} ({steps})")
    imitation = [config.imitation.steps * environment.num_envs] * rounds
    return imitation + [per_iteration] * -(-config.num_steps // per_iteration)


def _begin(
    checkpoints: ocp.CheckpointManager,
    compiled: Compiled,
    config: PPOConfig,
    environment: VectorEnv,
    seed: int,
    directory: Path,
) -> Session:
    """A new session, or the one of the latest checkpoint; the log is cut to where it begins."""
    state = initial_state(compiled.initialise, config, environment, seed)
    session = Session(state, {}, environment, EpisodeLog(environment.num_envs))
    done = checkpoints.latest_step()
    ckpt.rewind_log(directory / PROGRESS, "iteration", -1 if done is None else done)
    if done is None:
        return Session(state, environment.reset(), environment, session.episodes)
    session = restore_session(checkpoints, done, session)
    _export_if_best(checkpoints, session, config, directory)
    return session


def _export_if_best(checkpoints: ocp.CheckpointManager, session: Session, config: PPOConfig, directory: Path) -> None:
    """Writes the policy of the latest checkpoint if it is the one to keep."""
    if checkpoints.best_step() == checkpoints.latest_step():
        save_policy(directory / POLICY, policy_of(session.state, config))


def _identity(config: PPOConfig, environment: VectorEnv, seed: int) -> str:
    sizes = [environment.num_envs, environment.action_size, environment.observation_sizes]
    return artifacts.hash_of([as_mapping(config), sizes, seed])


def _note(record: Record) -> str:
    shown = ((name, record.get(name)) for name in ("return", "reward", "std", "kl"))
    return ", ".join(f"{name} {value:.3g}" for name, value in shown if value is not None)
