"""What a training leaves in its directory: records, checkpoints, the policy kept. The first process keeps these books."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import jax
import orbax.checkpoint as ocp

from qjrl import artifacts
from qjrl.learning import checkpoints as ckpt
from qjrl.learning import processes
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.iteration import Record
from qjrl.learning.ppo.policy import Policy, load_policy, save_policy
from qjrl.learning.ppo.training_state import (
    Session,
    policy_of,
    read_snapshot,
    restored,
    snapshot,
    write_snapshot,
)

Evaluate = Callable[[Policy], Mapping[str, float | None]]

POLICY, PROGRESS, CHECKPOINTS, DIVERGED = "policy", "progress.jsonl", "checkpoints", "diverged.npz"


@dataclasses.dataclass(frozen=True)
class Books:
    """Every process calls the same methods; those that are not the first write nothing and get what the first has."""

    directory: Path
    config: PPOConfig
    evaluate: Evaluate | None
    callbacks: list[Callable[[Record], None]]
    checkpoints: ocp.CheckpointManager | None
    """None in a process that is not the first."""

    def begin(self, session: Session) -> tuple[Session, bool]:
        """The session of the latest checkpoint or `session`, a new one; and whether it is new. The log is cut to fit."""
        found = snapshot(session)
        done = None
        if self.checkpoints is not None:
            done = self.checkpoints.latest_step()
            ckpt.rewind_log(self.directory / PROGRESS, "iteration", -1 if done is None else done)
            found = found if done is None else read_snapshot(self.checkpoints, done, found)
        if processes.of_first(done is None):
            return session, True
        session = restored(session, processes.of_first(found))
        self._export_if_best(session)
        return session, False

    def write(self, record: Record) -> None:
        """A line of the log."""
        if self.checkpoints is not None:
            artifacts.append_json_line(self.directory / PROGRESS, record)
            for callback in self.callbacks:
                callback(record)

    def keep(self, session: Session, record: Record) -> None:
        """A judgement, a line and a checkpoint. After a crash in between, the resumed training writes the same line again."""
        whole = snapshot(session)
        if self.checkpoints is None:
            return
        metrics = None if self.evaluate is None else dict(self.evaluate(policy_of(session.state, self.config)))
        self.write(record | {f"evaluation/{name}": value for name, value in (metrics or {}).items()})
        write_snapshot(self.checkpoints, whole, metrics)
        self._export_if_best(session)

    def policy(self, session: Session) -> Policy:
        """The policy kept."""
        like = policy_of(session.state, self.config)
        return processes.of_first(like if self.checkpoints is None else load_policy(self.directory / POLICY))

    @contextmanager
    def evidence(self) -> Iterator[None]:
        """Writes what a `TrainingDiverged` knows into the directory, and names the file in its message."""
        try:
            yield
        except TrainingDiverged as error:
            if not error.evidence:
                raise
            path = self.directory / (DIVERGED if processes.is_first() else f"diverged-{jax.process_index()}.npz")
            artifacts.write_arrays(path, error.evidence)
            raise TrainingDiverged(f"{error}; states, commands and parameters: {path}", error.evidence) from error

    def _export_if_best(self, session: Session) -> None:
        """Writes the policy of the latest checkpoint if it is the one to keep."""
        if self.checkpoints is not None and self.checkpoints.best_step() == self.checkpoints.latest_step():
            save_policy(self.directory / POLICY, policy_of(session.state, self.config))


@contextmanager
def open_books(
    directory: Path,
    identity: str,
    config: PPOConfig,
    evaluate: Evaluate | None,
    minimise: str | None,
    callbacks: list[Callable[[Record], None]],
) -> Iterator[Books]:
    """The books of a training.

    Args:
        identity: hash of what defines the training.
        evaluate, minimise, callbacks: as for `train.train`.
    Raises:
        ArtifactError: the directory holds another training.
    """
    if not processes.is_first():
        yield Books(directory, config, None, [], None)
        return
    with ckpt.open_checkpoints(directory / CHECKPOINTS, identity, minimise) as checkpoints:
        yield Books(directory, config, evaluate, callbacks, checkpoints)
