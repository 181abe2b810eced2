"""What a training leaves in its directory: records, checkpoints, the policy kept. The first process alone writes."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import jax
import orbax.checkpoint as ocp
from jax.sharding import Mesh

from qjrl import artifacts
from qjrl.learning import checkpoints as ckpt
from qjrl.learning import processes
from qjrl.learning.checkpoints import no_choice
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.policy import Policy, load_policy, save_policy
from qjrl.learning.ppo.records import Record
from qjrl.learning.ppo.trainer_state import (
    TrainerState,
    policy_of,
    read_snapshot,
    restored,
    snapshot,
    write_snapshot,
)

Evaluate = Callable[[Policy], Mapping[str, float | None]]

POLICY, PROGRESS, CHECKPOINTS, DIVERGED = "policy", "progress.jsonl", "checkpoints", "diverged.npz"


@dataclasses.dataclass(frozen=True)
class Checkpointer:
    """Every process calls the same methods; those that are not the first write nothing and get what the first has."""

    directory: Path
    config: PPOConfig
    mesh: Mesh
    evaluate: Evaluate | None
    minimise: str | None
    callbacks: list[Callable[[Record], None]]
    checkpoints: ocp.CheckpointManager | None
    """None in a process that is not the first."""

    def begin(self, trainer: TrainerState) -> tuple[TrainerState, bool]:
        """The state of the latest checkpoint or `trainer`, a new one; and whether it is new. The log is cut to fit."""
        found = snapshot(trainer)
        done = None
        if self.checkpoints is not None:
            done = self.checkpoints.latest_step()
            ckpt.rewind_log(self.directory / PROGRESS, "iteration", -1 if done is None else done)
            found = found if done is None else read_snapshot(self.checkpoints, done, found)
        if processes.of_first(done is None):
            return trainer, True
        trainer = restored(trainer, processes.of_first(found), self.mesh)
        self._export_if_best(trainer)
        return trainer, False

    def write(self, record: Record) -> None:
        """A line of the log."""
        if self.checkpoints is not None:
            artifacts.append_json_line(self.directory / PROGRESS, record)
            for callback in self.callbacks:
                callback(record)

    def keep(self, trainer: TrainerState, record: Record) -> None:
        """An evaluation, a line and a checkpoint. After a crash in between, the resumed training writes the same line again."""
        whole = snapshot(trainer)
        if self.checkpoints is None:
            return
        metrics = None if self.evaluate is None else dict(self.evaluate(policy_of(trainer, self.config)))
        self.write(record | {f"evaluation/{name}": value for name, value in (metrics or {}).items()})
        write_snapshot(self.checkpoints, whole, metrics)
        self._export_if_best(trainer)

    def policy(self, trainer: TrainerState) -> Policy:
        """The policy kept.

        Raises:
            ArtifactError: no checkpoint has a finite metric.
        """
        like = policy_of(trainer, self.config)
        return processes.of_first(like if self.checkpoints is None else self._kept())

    def _kept(self) -> Policy:
        path = self.directory / POLICY
        if not path.with_suffix(".npz").exists():
            raise no_choice(self.directory / CHECKPOINTS, self.minimise or "the metric")
        return load_policy(path)

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

    def _export_if_best(self, trainer: TrainerState) -> None:
        """Writes the policy of the latest checkpoint if it is the one to keep."""
        if self.checkpoints is not None and self.checkpoints.best_step() == self.checkpoints.latest_step():
            save_policy(self.directory / POLICY, policy_of(trainer, self.config))


@contextmanager
def open_checkpointer(
    directory: Path,
    identity: str,
    config: PPOConfig,
    mesh: Mesh,
    evaluate: Evaluate | None,
    minimise: str | None,
    callbacks: list[Callable[[Record], None]],
) -> Iterator[Checkpointer]:
    """The checkpointer of a training.

    Args:
        identity: hash of what defines the training.
        evaluate, minimise, callbacks: as for `train.train`.
    Raises:
        ArtifactError: the directory holds another training.
    """
    if not processes.is_first():
        yield Checkpointer(directory, config, mesh, None, None, [], None)
        return
    with ckpt.open_checkpoints(directory / CHECKPOINTS, identity, minimise) as checkpoints:
        yield Checkpointer(directory, config, mesh, evaluate, minimise, callbacks, checkpoints)
