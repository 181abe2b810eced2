"""Inverse kinematics by gradient descent with Adam and random restarts (paper 000, section 4)."""

import functools
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from qjrl.config import Range, configuration
from qjrl.robot.ik_result import SolveResult, check_targets, describe_solution
from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.pose_model import PoseFunction, as_model, or_closed_form
from qjrl.robot.verbs import Robot, cable_lengths, cable_strokes, configuration_from_cables, within_limits


@configuration
class AdamConfig:
    """Group `ik`. Iterations, rate and restarts: paper 000, section 4; its loss weights are not printed: ours."""

    iterations: Annotated[int, Range(1, 100_000)] = 200
    """Steps of Adam."""
    learning_rate: Annotated[float, Range(above=0.0, high=1.0)] = 0.05
    """In lengths scaled by each cable's stroke."""
    decay: bool = False
    """Cosine of the rate to 0 (ours); false: constant, as in the paper."""
    num_restarts: Annotated[int, Range(1, 1024)] = 8
    """Starts of every target; the best end is the answer."""
    num_candidates: Annotated[int, Range(1, 1_000_000)] = 4096
    """Random feasible lengths of which the nearest start (ours); equal to num_restarts: plainly random, as in the paper."""
    num_retries: Annotated[int, Range(0, 100)] = 2
    """Times a target that has not converged starts again, from the next nearest candidates (ours)."""
    position_scale: Annotated[float, Range(above=0.0)] = 0.01
    """Position error that costs 1 [m]."""
    orientation_scale: Annotated[float, Range(above=0.0)] = 0.05
    """Orientation error that costs about 1 [rad]."""
    control_penalty: Annotated[float, Range(low=0.0)] = 1e-3
    """Times the squared scaled lengths: picks one of the arm's redundant answers."""
    position_tolerance: Annotated[float, Range(above=0.0)] = 1e-3
    """Predicted position error that counts as converged [m]."""
    orientation_tolerance: Annotated[float, Range(above=0.0)] = 0.00872664625997165
    """Predicted orientation error that counts as converged [rad]: 0.5 degrees."""
    batch_size: Annotated[int, Range(1, 65536)] = 64
    """Targets solved at once."""


def solve_adam(
    robot: Robot,
    targets: Any,
    model: PoseFunction | None = None,
    config: AdamConfig = AdamConfig(),
    seed: int = 0,
    advance=None,
) -> SolveResult:
    """Cable lengths whose pose under `model` is nearest to each target.

    Args:
        robot: the arm.
        targets: (n, 9) poses [m, -].
        model: lengths (num_cables,) [m] -> pose (9,), as in `solve_least_squares`; default: the nominal closed form.
        config: steps, restarts, weights, tolerances.
        seed: of the candidates for the starts, which all targets share.
        advance: called with the number of newly solved targets.
    Raises:
        ValueError: targets of the wrong shape, non-finite, or no rotations; a model that cannot be called.
    """
    checked, model = check_targets(robot, targets), as_model(model)
    candidates = _candidates(config, model, robot, jax.random.key(seed))

    lengths, steps = np.zeros((len(checked), robot.num_cables)), np.zeros(len(checked), int)
    result = _evaluate(config, model, robot, checked, lengths, steps)
    for attempt in range(config.num_retries + 1):
        pending = np.flatnonzero(~np.asarray(result.converged))
        for start in range(0, len(pending), config.batch_size):
            rows = pending[start : start + config.batch_size]
            padded = np.resize(rows, config.batch_size)  # repeats rows: one compilation whatever their number
            ends = _solve_rows(config, model, robot, checked[padded], candidates, attempt)
            lengths[rows] = np.asarray(ends)[: len(rows)]
            steps[rows] += config.iterations * config.num_restarts
            if advance and attempt == 0:
                advance(len(rows))
        result = _better(config, result, _evaluate(config, model, robot, checked, lengths, steps))
        lengths = np.array(result.cable_lengths)
    return result


def _better(config: AdamConfig, before: SolveResult, after: SolveResult) -> SolveResult:
    """Row by row the answer with the smaller error in tolerances; the steps count all attempts."""
    is_better = _scaled_error(config, after) < _scaled_error(config, before)
    pick = lambda new, old: jnp.where(is_better.reshape(-1, *[1] * (new.ndim - 1)), new, old)  # noqa: E731
    return jax.tree.map(pick, after, before).replace(steps=after.steps)


def _scaled_error(config: AdamConfig, result: SolveResult) -> np.ndarray:
    """Error of each answer in tolerances: what a retry must improve."""
    position = np.asarray(result.position_error) / config.position_tolerance
    return np.maximum(position, np.asarray(result.orientation_error) / config.orientation_tolerance)


@struct.dataclass
class _Candidates:
    """Feasible lengths (candidates, cables) [m] and the model's poses of them (candidates, 9)."""

    lengths: jax.Array
    poses: jax.Array


@functools.partial(jax.jit, static_argnums=0)
def _candidates(config: AdamConfig, model: PoseFunction | None, robot: Robot, key: jax.Array) -> _Candidates:
    count = max(config.num_candidates, config.num_restarts * (config.num_retries + 1))
    numbers = jax.random.uniform(key, (count, num_coordinates(robot)))
    lengths = jax.vmap(lambda row: cable_lengths(robot, kind_of(robot).from_unit_cube(robot, row)))(numbers)
    return _Candidates(lengths, jax.vmap(or_closed_form(robot, model))(lengths))


@functools.partial(jax.jit, static_argnums=0)
def _solve_rows(
    config: AdamConfig, model: PoseFunction | None, robot: Robot, targets, candidates: _Candidates, attempt
) -> jax.Array:
    pose_of = or_closed_form(robot, model)
    return jax.vmap(lambda target: _solve_one(robot, pose_of, config, target, candidates, attempt))(targets)


@functools.partial(jax.jit, static_argnums=0)
def _evaluate(config: AdamConfig, model: PoseFunction | None, robot: Robot, targets, lengths, steps) -> SolveResult:
    tolerances = (config.position_tolerance, config.orientation_tolerance)
    return describe_solution(robot, or_closed_form(robot, model), targets, lengths, tolerances, steps)


def _solve_one(
    robot: Robot,
    model: PoseFunction,
    config: AdamConfig,
    target: jax.Array,
    candidates: _Candidates,
    attempt: jax.Array,
) -> jax.Array:
    """Lengths (num_cables,) of the best of all restarts for one target (9,); attempt 0 has the nearest candidates."""
    strokes = cable_strokes(robot)
    distances = jax.vmap(lambda pose: _pose_cost(config, pose, target))(candidates.poses)
    nearest = jax.lax.dynamic_slice_in_dim(jnp.argsort(distances), attempt * config.num_restarts, config.num_restarts)
    cost = lambda scaled: _cost(robot, model, config, target, scaled * strokes)  # noqa: E731
    project = lambda scaled: cable_lengths(robot, _within_limit(robot, scaled * strokes)) / strokes  # noqa: E731
    ends = _descend(jax.vmap(cost), jax.vmap(project), candidates.lengths[nearest] / strokes, config)
    return ends[jnp.argmin(jax.vmap(cost)(ends))] * strokes


def _descend(costs, project, starts: jax.Array, config: AdamConfig) -> jax.Array:
    """Adam on every row of `starts` (restarts, cables) side by side; `costs` maps it to (restarts,).

    `project` brings each row back within the joints' limits after every step (ours).
    """
    rate = (
        optax.cosine_decay_schedule(config.learning_rate, config.iterations) if config.decay else config.learning_rate
    )
    optimiser = optax.adam(rate)

    def step(carry, _):
        scaled, state = carry
        gradient = jax.grad(lambda rows: jnp.sum(costs(rows)))(scaled)
        updates, state = optimiser.update(gradient, state)
        return (project(scaled + updates), state), None

    (ends, _), _ = jax.lax.scan(step, (starts, optimiser.init(starts)), length=config.iterations)
    return ends


def _within_limit(robot: Robot, lengths: jax.Array) -> jax.Array:
    """The nominal configuration of lengths, brought back within its limits."""
    return within_limits(robot, configuration_from_cables(robot, lengths))


def _cost(robot: Robot, model: PoseFunction, config: AdamConfig, target: jax.Array, lengths: jax.Array) -> jax.Array:
    """Position + rotation + small control penalty (paper 000, section 4)."""
    return _pose_cost(config, model(lengths), target) + config.control_penalty * jnp.sum(
        (lengths / cable_strokes(robot)) ** 2
    )


def _pose_cost(config: AdamConfig, pose: jax.Array, target: jax.Array) -> jax.Array:
    """1 at one position scale, about 1 at one orientation scale: frames an angle e apart differ by e in their columns."""
    position = jnp.sum((pose[:3] - target[:3]) ** 2) / config.position_scale**2
    return position + jnp.sum((pose[3:] - target[3:]) ** 2) / config.orientation_scale**2
