"""The one fitting loop: any network, any arrays of inputs and targets.

The data live on the device and one call runs one epoch. The order of the rows is a function of (seed, epoch)
alone, so a fit that was interrupted and resumed equals one that was not, bit for bit.
"""

import dataclasses
import hashlib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import linen, struct

from qjrl import artifacts, progress
from qjrl.config import Range, as_mapping, configuration
from qjrl.keys import seed_for
from qjrl.learning import checkpoints as ckpt
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.fit_log import FitLog

Predict = Callable[[Any], jax.Array]
Loss = Callable[[jax.Array, jax.Array], jax.Array]


@configuration
class FitConfig:
    """AdamW with a warm-up and a cosine. All values ours; 9,000 rows, width 256: about 35 s of CPU, in batches of 256 20 s."""

    epochs: Annotated[int, Range(1)] = 60
    """Passes over the data."""
    batch_size: Annotated[int, Range(1)] = 64
    """Rows in one gradient step; what does not fill the last batch of an epoch waits for another epoch. On 9,000 rows 64 and
    256 gave 0.116 and 0.152 mm held out."""
    learning_rate: Annotated[float, Range(above=0, high=1)] = 3e-3
    """Highest rate, reached after the warm-up; the cosine ends at 0."""
    warmup_fraction: Annotated[float, Range(0, 1)] = 0.05
    """Part of all steps in which the rate rises from 0."""
    weight_decay: Annotated[float, Range(0, 10)] = 0.1
    """Of AdamW. On 9,000 rows in batches of 64, 0.01, 0.1 and 0.3 gave 0.142, 0.116 and 0.143 mm held out."""
    max_gradient_norm: Annotated[float, Range(above=0)] = 1.0
    """Larger gradients are scaled down to this global norm."""
    evaluate_every: Annotated[int, Range(1)] = 5
    """Epochs between two evaluations; each writes a checkpoint and a line of `progress.jsonl`."""


@struct.dataclass
class FittedNetwork:
    """What a prediction needs beside the network's structure. All float32."""

    parameters: Any
    output_mean: Any
    """(outputs,) mean of the training targets."""
    output_std: Any
    """(outputs,) their standard deviation."""
    num_members: int = struct.field(pytree_node=False, default=1)
    """Of an ensemble: above 1 every parameter has a leading axis of so many networks."""


@dataclasses.dataclass(frozen=True)
class FitResult:
    """The best checkpoint of a fit."""

    fitted: FittedNetwork
    epoch: int
    metrics: dict[str, float]
    """What `evaluate` said of it."""


@struct.dataclass
class FitState:
    """Everything that changes during a fit, and the key of its data order."""

    parameters: Any
    optimiser_state: Any
    order_key: Any


@struct.dataclass
class Rows:
    """The training data on the device, float32."""

    inputs: Any
    """(rows, n)."""
    targets: Any
    """(rows, outputs), normalised."""


def predict(network: linen.Module, fitted: FittedNetwork, inputs: Any) -> jax.Array:
    """The network's answer in the units of the targets, an ensemble's mean: (..., inputs) -> (..., outputs) float32."""
    if fitted.num_members > 1:
        return jnp.mean(predict_members(network, fitted, inputs), axis=0)
    normalised: Any = network.apply({"params": fitted.parameters}, jnp.asarray(inputs, jnp.float32))
    return normalised * fitted.output_std + fitted.output_mean


def predict_members(network: linen.Module, fitted: FittedNetwork, inputs: Any) -> jax.Array:
    """Every member's answer: (..., inputs) -> (members, ..., outputs) float32."""
    if fitted.num_members == 1:
        return predict(network, fitted, inputs)[None]

    def member(index: int) -> jax.Array:
        parameters = jax.tree.map(lambda leaf: leaf[index], fitted.parameters)
        return predict(network, dataclasses.replace(fitted, parameters=parameters, num_members=1), inputs)

    return jnp.stack([member(index) for index in range(fitted.num_members)])


def mean_squared_error(predicted: jax.Array, target: jax.Array) -> jax.Array:
    """Mean over rows and columns, in normalised units."""
    return jnp.mean(jnp.square(predicted - target))


def fit(
    config: FitConfig,
    network: linen.Module,
    data: tuple[Any, Any],
    evaluate: Callable[[Predict], Mapping[str, float]],
    minimise: str,
    directory: Path,
    seed: int,
    loss: Loss = mean_squared_error,
    label: str = "fit",
    num_members: int = 1,
) -> FitResult:
    """Fits `network` to (inputs, targets); goes on where an earlier call in the same directory stopped.

    Args:
        data: inputs (rows, n), already scaled, and targets (rows, outputs), in any unit.
        evaluate: held-out errors of a function (rows, n) -> (rows, outputs) in the targets' unit; called before the
            first epoch too.
        minimise: the metric of `evaluate` by which the best checkpoint is chosen.
        directory: gets `checkpoints/` and `progress.jsonl`.
        loss: scalar from predicted and target rows, both normalised by the training statistics of the targets.
        num_members: networks fitted together by vmap; number i is the plain fit of `member_seed(seed, i)`.
    Raises:
        TrainingDiverged: the training loss is not finite.
        ArtifactError: the directory holds a fit with another configuration or other data, or every checkpoint's metric is not
            finite.
    """
    rows, mean, std = _prepare(*data)
    steps_per_epoch = _steps_per_epoch(config, len(rows.inputs))
    state = _initial_state(config, network, rows, seed, num_members)
    answer = jax.jit(predict, static_argnums=0)
    log = FitLog(directory / "progress.jsonl")
    identity = _identity(config, state, seed, data)

    def evaluated(state: FitState, epoch: int, train_loss: float | None) -> dict[str, float]:
        fitted = FittedNetwork(state.parameters, mean, std, num_members)
        metrics = dict(evaluate(lambda inputs: answer(network, fitted, inputs)))
        log.append(epoch, epoch * steps_per_epoch, train_loss, metrics)
        return metrics

    with ckpt.open_checkpoints(directory / "checkpoints", identity, minimise) as checkpoints:
        done = checkpoints.latest_step()
        log.rewind(done)
        if done is None:
            ckpt.save(checkpoints, 0, state, evaluated(state, 0, None))
        else:
            state = ckpt.restore(checkpoints, done, state)
        with progress.compiling(f"one epoch of {label}"):
            train = train_epoch if num_members == 1 else train_epoch_of_members
            run_epoch = jax.jit(train, static_argnums=(0, 1, 2), donate_argnums=3)
        with progress.track(config.epochs, label, already=done or 0) as advance:
            for epoch in range((done or 0) + 1, config.epochs + 1):
                state, losses = run_epoch(config, network, loss, state, rows, epoch)
                train_loss = _checked(losses, epoch)
                if epoch % config.evaluate_every == 0 or epoch == config.epochs:
                    ckpt.save(checkpoints, epoch, state, evaluated(state, epoch, train_loss))
                advance(1, note=log.note(minimise))
        best = ckpt.chosen(checkpoints, minimise)
        fitted = FittedNetwork(ckpt.restore(checkpoints, best, state).parameters, mean, std, num_members)
        return FitResult(fitted, best, dict(checkpoints.metrics(best)))


def train_epoch(
    config: FitConfig, network: linen.Module, loss: Loss, state: FitState, rows: Rows, epoch: jax.Array
) -> tuple[FitState, jax.Array]:
    """One pass over the rows: the state after it, and the losses of its steps, (steps,)."""
    num_rows = len(rows.inputs)
    optimiser = make_optimiser(config, config.epochs * _steps_per_epoch(config, num_rows))

    def step(state: FitState, order: jax.Array) -> tuple[FitState, jax.Array]:
        batch = jax.tree.map(lambda column: column[order], rows)
        value, gradient = jax.value_and_grad(_batch_loss)(state.parameters, network, loss, batch)
        updates, optimiser_state = optimiser.update(gradient, state.optimiser_state, state.parameters)
        parameters = optax.apply_updates(state.parameters, updates)
        return dataclasses.replace(state, parameters=parameters, optimiser_state=optimiser_state), value

    return jax.lax.scan(step, state, epoch_order(state.order_key, epoch, num_rows, config.batch_size))


def train_epoch_of_members(
    config: FitConfig, network: linen.Module, loss: Loss, state: FitState, rows: Rows, epoch: jax.Array
) -> tuple[FitState, jax.Array]:
    """`train_epoch` of every member of an ensemble, each in an order of its own; losses (members, steps)."""
    return jax.vmap(lambda one: train_epoch(config, network, loss, one, rows, epoch))(state)


def member_seed(seed: int, member: int) -> int:
    """Seed of one member of an ensemble; the first has the ensemble's own."""
    return seed if member == 0 else seed_for(seed, "members of an ensemble", member)


def make_optimiser(config: FitConfig, num_steps: int) -> optax.GradientTransformation:
    """AdamW behind a global-norm clip; the rate rises linearly, then follows a cosine to 0."""
    warmup = round(config.warmup_fraction * num_steps)
    schedule = optax.warmup_cosine_decay_schedule(
        init_value=config.learning_rate if warmup == 0 else 0.0,
        peak_value=config.learning_rate,
        warmup_steps=warmup,
        decay_steps=max(num_steps, warmup + 1),
    )
    adamw = optax.adamw(schedule, weight_decay=config.weight_decay)
    return optax.chain(optax.clip_by_global_norm(config.max_gradient_norm), adamw)


def epoch_order(key: jax.Array, epoch: jax.Array | int, num_rows: int, batch_size: int) -> jax.Array:
    """Which rows make which batch of this epoch: (steps, batch) int32, a function of key and epoch alone."""
    batch_size = min(batch_size, num_rows)
    num_batches = num_rows // batch_size
    order = jax.random.permutation(jax.random.fold_in(key, epoch), jnp.arange(num_rows, dtype=jnp.int32))
    return order[: num_batches * batch_size].reshape(num_batches, batch_size)


def _batch_loss(parameters: Any, network: linen.Module, loss: Loss, batch: Rows) -> jax.Array:
    predicted: Any = network.apply({"params": parameters}, batch.inputs)
    return loss(predicted, batch.targets)


def _steps_per_epoch(config: FitConfig, num_rows: int) -> int:
    return max(1, num_rows // config.batch_size)


def _prepare(inputs: Any, targets: Any) -> tuple[Rows, jax.Array, jax.Array]:
    """The rows on the device, targets normalised, and the mean and std they were normalised by.

    The statistics are summed in float64: a mean of a million float32 poses would lose the micrometres.
    """
    if len(inputs) != len(targets) or len(inputs) == 0:
        raise ValueError(f"inputs and targets: got {len(inputs)} and {len(targets)} rows, expected as many of both")
    wide = np.asarray(targets, np.float64)
    mean, std = wide.mean(axis=0), wide.std(axis=0)
    std = np.where(std > 1e-12 * (1.0 + np.abs(mean)), std, 1.0)  # a constant column has no scale
    rows = Rows(jnp.asarray(inputs, jnp.float32), jnp.asarray((wide - mean) / std, jnp.float32))
    return rows, jnp.asarray(mean, jnp.float32), jnp.asarray(std, jnp.float32)


def _initial_state(config: FitConfig, network: linen.Module, rows: Rows, seed: int, num_members: int = 1) -> FitState:
    initialise = jax.jit(_initial_parameters, static_argnums=0)

    def member(index: int) -> FitState:
        parameter_key, order_key = jax.random.split(jax.random.key(member_seed(seed, index)))
        parameters = initialise(network, parameter_key, rows.inputs[:1])
        # The optimiser's state does not depend on how many steps its schedule has.
        return FitState(parameters, make_optimiser(config, 1).init(parameters), order_key)

    members = [member(index) for index in range(num_members)]
    state = members[0] if num_members == 1 else jax.tree.map(lambda *leaves: jnp.stack(leaves), *members)
    return jax.device_put(state, jax.local_devices()[0])  # committed, as a restored one is: one compilation for both


def _initial_parameters(network: linen.Module, key: jax.Array, inputs: jax.Array) -> Any:
    return network.init(key, inputs)["params"]


def _identity(config: FitConfig, state: FitState, seed: int, data: tuple[Any, Any]) -> str:
    """Two calls with the same identity compute the same fit."""
    shapes = str(jax.tree.map(jnp.shape, state.parameters))
    contents = [hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest() for array in data]
    return artifacts.hash_of([as_mapping(config), shapes, seed, contents])


def _checked(losses: jax.Array, epoch: int) -> float:
    """The epoch's mean loss; the one place where the host waits for the device."""
    mean = float(jnp.mean(losses))
    if not math.isfinite(mean):
        raise TrainingDiverged(f"the training loss of epoch {epoch} is {mean}; try a smaller learning_rate")
    return mean
