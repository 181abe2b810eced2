"""Training states on disk, by orbax: the latest one to go on from, and the best one to use.

A checkpoint is a directory that appears in one rename, so an interruption leaves the one before it. Of several processes of
JAX's distributed runtime the first alone writes and reads, arrays of its own.
"""

import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp
from orbax.checkpoint.checkpoint_managers import AnyPreservationPolicy, BestN, LatestN

from qjrl import artifacts, plain_json
from qjrl.records import holds_numbers

TRAINING, ENVIRONMENT, IDENTITY = "training", "environment", "identity.json"


def open_checkpoints(directory: Path, identity: str, minimise: str | None = None) -> ocp.CheckpointManager:
    """Opens (or creates) the checkpoints of one training; use it in a `with` statement.

    Args:
        identity: hash of what defines the training; a directory of another training is refused.
        minimise: metric by which the best checkpoint is kept beside the latest; None: the latest alone.
    Raises:
        ArtifactError: the directory belongs to another training.
    """
    _check_identity(directory, identity)
    policies: list[Any] = [LatestN(1)]
    ranking: dict[str, Any] = {}
    if minimise is not None:
        score = _score_of(minimise)
        # orbax keeps the end of the sorted list: descending, so that the smallest stays.
        policies.append(BestN(get_metric_fn=score, reverse=True, n=1, keep_checkpoints_without_metrics=False))
        ranking = {"best_fn": score, "best_mode": "min"}
    options = ocp.CheckpointManagerOptions(
        preservation_policy=AnyPreservationPolicy(policies),
        enable_async_checkpointing=False,
        cleanup_tmp_directories=True,
        create=False,  # `_check_identity` did; orbax would wait for the other processes
        multiprocessing_options=ocp.options.MultiprocessingOptions(
            primary_host=0, active_processes={0}, barrier_sync_key_prefix="first"
        ),
        **ranking,
    )
    return _Checkpoints(directory.absolute(), options=options, minimise=minimise)


class _Checkpoints(ocp.CheckpointManager):
    """Never takes a checkpoint for the best of which nothing is known."""

    def __init__(self, *arguments: Any, minimise: str | None, **options: Any):
        super().__init__(*arguments, **options)
        self._minimise = minimise

    def best_step(self) -> int | None:
        """The step with the smallest metric; None: no checkpoint has a finite one."""
        step = super().best_step()
        if step is None or self._minimise is None:
            return step
        return step if math.isfinite(_score_of(self._minimise)(self.metrics(step) or {})) else None


def save(
    checkpoints: ocp.CheckpointManager,
    step: int,
    state: Any,
    metrics: Mapping[str, float | None] | None = None,
    environment: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Writes one checkpoint and drops those that are neither latest nor best.

    Args:
        state: any pytree of arrays, typed keys included.
        environment: flat dict of numpy arrays, kept bit for bit whatever their dtype and shape.
    """
    items = {TRAINING: ocp.args.StandardSave(state)}
    if environment is not None:
        items[ENVIRONMENT] = ocp.args.StandardSave({"npz": _packed(environment)})
    checkpoints.save(step, args=ocp.args.Composite(**items), metrics=None if metrics is None else dict(metrics))


def restore(checkpoints: ocp.CheckpointManager, step: int, like: Any) -> Any:
    """The training state of one checkpoint, on the devices and with the dtypes of `like`."""
    abstract = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
    restored = checkpoints.restore(step, args=ocp.args.Composite(**{TRAINING: ocp.args.StandardRestore(abstract)}))
    return restored[TRAINING]


def restore_environment(checkpoints: ocp.CheckpointManager, step: int) -> dict[str, np.ndarray]:
    """The environment arrays of one checkpoint, as they were given to `save`."""
    restored = checkpoints.restore(step, args=ocp.args.Composite(**{ENVIRONMENT: ocp.args.StandardRestore()}))
    return _unpacked(restored[ENVIRONMENT]["npz"])


def chosen(checkpoints: ocp.CheckpointManager, minimise: str) -> int:
    """The best step, to use.

    Raises:
        ArtifactError: no checkpoint has a finite metric, so that the choice would be blind.
    """
    step = checkpoints.best_step()
    if step is None:
        raise no_choice(Path(checkpoints.directory), minimise)
    return step


def no_choice(directory: Path, minimise: str) -> artifacts.ArtifactError:
    """The error of a training of which no checkpoint is worth anything."""
    return artifacts.ArtifactError(
        f"{directory}: no checkpoint has a finite {minimise}, so none can be chosen; data or simulation are unsound: look into "
        "progress.jsonl beside it"
    )


def rewind_log(path: Path, counter: str, last: int) -> list[dict[str, Any]]:
    """Cuts a `.jsonl` log back to a restored checkpoint: no record after `last`, no half-written or damaged line.

    Returns:
        The records kept.
    """
    kept = []
    for line in path.read_text(errors="replace").splitlines() if path.exists() else []:
        try:
            record = json.loads(line)
        except ValueError:
            break
        if not holds_numbers(record) or not isinstance(record.get(counter), int | float) or record[counter] > last:
            break
        kept.append(record)
    artifacts.write_bytes(path, "".join(plain_json.dumps(record) + "\n" for record in kept).encode())
    return kept


def _check_identity(directory: Path, identity: str) -> None:
    path = directory / IDENTITY
    if (
        path.exists()
        and artifacts.read_record(path, {"identity": str}, "the identity of a training")["identity"] != identity
    ):
        raise artifacts.ArtifactError(
            f"{directory}: holds a training with another configuration or data; remove it to start afresh"
        )
    artifacts.write_json(path, {"identity": identity})


def _score_of(name: str) -> Any:
    def score(metrics: Mapping[str, float | None]) -> float:
        value = metrics.get(name)
        return value if value is not None and math.isfinite(value) else math.inf  # NaN has no place in a sort

    return score


def _packed(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """One byte array: orbax refuses empty arrays and rewrites some dtypes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return np.frombuffer(buffer.getvalue(), np.uint8)


def _unpacked(packed: np.ndarray) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(np.asarray(packed).tobytes()), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
