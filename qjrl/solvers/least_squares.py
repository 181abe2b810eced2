"""Inverse kinematics by damped least squares from several starts: few for easy targets, many for hard ones."""

import dataclasses
import functools
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.config import Range, configuration
from qjrl.robot.batching import in_batches
from qjrl.robot.ik_result import (
    SolveResult,
    Status,
    check_initial_configurations,
    check_targets,
    describe_solution,
    least_tension,
)
from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.pose_model import PoseFunction, as_model, is_chain, or_closed_form
from qjrl.robot.verbs import Robot
from qjrl.solvers.candidates import Candidates, nearest_candidates, random_candidates
from qjrl.solvers.levenberg_marquardt import DescentConfig, descend, is_nearest
from qjrl.solvers.model_tip import exact_tip_function, lengths_of, tip_function
from qjrl.xla_options import jit_of_chains


@configuration
class RoundConfig:
    """What every target that is not solved yet gets next."""

    num_starts: Annotated[int, Range(1, 1024)]
    """Descents of a target, side by side."""
    iterations: Annotated[int, Range(1, 10_000)]
    """Steps of each at most."""


@configuration
class LeastSquaresConfig:
    """Solver settings; all values ours."""

    descent: DescentConfig = DescentConfig()
    """Weights, damping, tolerances."""
    rounds: tuple[RoundConfig, ...] = (
        RoundConfig(1, 10),
        RoundConfig(4, 25),
        RoundConfig(16, 50),
        RoundConfig(64, 100),
    )
    """The next only for targets that the ones before have not solved; the best so far goes on as one of the starts."""
    model_damping: Annotated[float, Range(above=0.0)] = 1e-4
    """As `descent.damping`, of descents on a model: they begin next to their answers."""
    nearest_iterations: Annotated[int, Range(0, 10_000)] = 60
    """Steps of a last descent, of targets that no round has solved, to the nearest feasible pose."""
    least_tension: Annotated[float, Range(low=0.0)] = 2.0
    """What every strand shall carry at rest [N], predicted by statics: another answer is sought for a solved target whose
    answer leaves a strand less, and the one of largest least tension is taken. 0: never."""
    tension_round: RoundConfig = RoundConfig(8, 12)
    """Descents of such a target."""
    num_candidates: Annotated[int, Range(1, 100_000)] = 4096
    """Random poses; the starts of a target are the nearest of them."""
    batch_size: Annotated[int, Range(1, 65536)] = 512
    """Descents compiled together."""

    def __post_init__(self):
        if not self.rounds:
            raise ValueError("rounds: got [], allowed: at least one round")


def solve_least_squares(
    robot: Robot,
    targets: Any,
    initial_bends: Any = None,
    config: LeastSquaresConfig = LeastSquaresConfig(),
    candidates: Candidates | None = None,
    model: PoseFunction | None = None,
) -> SolveResult:
    """Cable lengths whose pose under `model` is nearest to each target, joint limits kept.

    A target out of reach gets the pose of least weighted squared error that any start finds, with the status NEAREST.
    The bends stay within their limit, and so do the cables within their strokes. Strands only pull: of a solved target's
    answers (an arm of more than three segments has a family of them) one that keeps all strands taut is sought. Where none
    is found the answer stays solved, and its `least_tension` says so.

    Args:
        robot: the arm.
        targets: (n, 9) poses [m, -].
        initial_bends: (n, segments, 2) or (segments, 2) to start from first, such as another solver's answer or a
            neighbour's; default: the nearest candidate, or for a model the closed form's answer.
        config: rounds of starts, tolerances.
        candidates: from `draw_candidates`, to be drawn once where many calls follow; default: drawn here.
        model: lengths (num_cables,) [m] -> pose (9,), near the nominal closed form, which is the default. A pytree that is
            called, as `pose_function` gives it: all of the same structure share what is compiled. A plain function is taken
            too; keep one for many calls, since each new one is compiled.
    Raises:
        ValueError: targets of the wrong shape, non-finite, or no rotations; initial bends of another shape; a model that
            cannot be called.
    """
    checked, model = check_targets(robot, targets), as_model(model)
    candidates = candidates or draw_candidates(robot, config)
    begun = _begun(robot, checked, initial_bends, config, candidates, model)
    best = _search(robot, checked, begun, config, candidates, model)
    result = _evaluate(robot, model, config, checked, best)
    return _tighten(robot, model, config, candidates, checked, result)


def _begun(robot: Robot, targets: np.ndarray, bends: Any, config, candidates: Candidates, model) -> np.ndarray | None:
    """Coordinates (n, coordinates) to start from first, if any; of the closed form's answer no tension that is not asked."""
    if bends is None and model is not None and config.least_tension == 0.0:
        return _search(robot, targets, None, config, candidates, None).coordinates
    if bends is None and model is not None:
        bends = solve_least_squares(robot, targets, None, config, candidates).bends
    if bends is None:
        return None
    return np.asarray(_coordinates_of(robot, check_initial_configurations(robot, bends, len(targets))))


def _search(robot: Robot, targets: np.ndarray, begun: np.ndarray | None, config, candidates, model) -> "_Best":
    """The best end of every target after the rounds it needs."""
    best = _nothing_found(robot, len(targets))
    if begun is not None:
        best = dataclasses.replace(best, coordinates=begun)
    for number, one_round in enumerate(config.rounds):
        rows = np.flatnonzero(best.status != Status.CONVERGED)
        if len(rows) == 0:
            break
        is_begun = number > 0 or begun is not None
        starts = _starts(config, candidates, best.coordinates[rows], targets[rows], number, is_begun)
        iterations = one_round.iterations
        if model is not None and number > 0:  # the way there on the closed form, which costs next to nothing
            starts = _descend(robot, None, config, starts, targets[rows], iterations).coordinates
            iterations = config.rounds[0].iterations
        best = _keep_better(best, rows, _descend(robot, model, config, starts, targets[rows], iterations))
    rows = np.flatnonzero(best.status != Status.CONVERGED)
    if len(rows) and config.nearest_iterations:
        starts, steps = best.coordinates[rows][:, None], config.nearest_iterations
        best = _keep_better(best, rows, _descend(robot, model, config, starts, targets[rows], steps, is_exact=True))
    return best


@jax.jit
def _coordinates_of(robot: Robot, configurations: jax.Array) -> jax.Array:
    return jax.vmap(lambda one: kind_of(robot).coordinates_of(robot, one))(configurations)


def draw_candidates(robot: Robot, config: LeastSquaresConfig = LeastSquaresConfig(), seed: int = 0) -> Candidates:
    """Poses all over the workspace for targets to start from: theta and phi uniform."""
    return random_candidates(robot, config.num_candidates, config.descent.rotation_weight, seed)


@struct.dataclass
class _Best:
    """The best end of every target so far; numpy."""

    coordinates: Any  # (n, coordinates)
    cost: Any  # (n,) [m^2]
    status: Any  # (n,)
    steps: Any  # (n,) iterations over all descents


def _nothing_found(robot: Robot, count: int) -> _Best:
    return _Best(
        np.zeros((count, num_coordinates(robot))),
        np.full(count, np.inf),
        np.full(count, int(Status.ITERATION_LIMIT)),
        np.zeros(count, int),
    )


def _starts(
    config: LeastSquaresConfig, candidates: Candidates, begun: np.ndarray, targets: np.ndarray, number: int, is_begun
) -> np.ndarray:
    """Starts (rows, starts, coordinates) of a round: what was begun, then the nearest candidates not used yet."""
    counts = [one_round.num_starts for one_round in config.rounds]
    used, fresh = sum(counts[:number]), counts[number] - bool(is_begun)
    drawn = candidates.coordinates[nearest_candidates(candidates, config.descent.rotation_weight, targets, used, fresh)]
    return np.concatenate([begun[:, None], drawn], axis=1) if is_begun else drawn


@struct.dataclass
class _Ends:
    """Ends of all descents, one row each."""

    coordinates: Any
    cost: Any
    status: Any
    steps: Any


def _descend(
    robot: Robot,
    model: PoseFunction | None,
    config: LeastSquaresConfig,
    starts: np.ndarray,
    targets: np.ndarray,
    iterations: int,
    is_exact: bool = False,
) -> _Ends:
    """The ends (rows, starts) of all descents of a round; `is_exact`: along the model's own Jacobian."""
    shape = starts.shape[:2]
    descent = config.descent if model is None else dataclasses.replace(config.descent, damping=config.model_damping)
    compiled = _descend_chain if model is None or is_chain(model) else _descend_layers
    function = functools.partial(compiled, descent, is_exact and model is not None, model, robot, np.int32(iterations))
    ends = in_batches(
        function, config.batch_size, starts.reshape(-1, *starts.shape[2:]), np.repeat(targets, shape[1], axis=0)
    )
    return jax.tree.map(lambda value: value.reshape(*shape, *value.shape[1:]), ends)


def _descend_rows(
    config: DescentConfig, is_exact: bool, model: PoseFunction | None, robot: Robot, iterations, starts, targets
) -> _Ends:
    tip = exact_tip_function(model) if is_exact else tip_function(model)
    state = descend(robot, config, jnp.moveaxis(starts, 0, -1), targets.T, iterations, tip)
    status = jnp.where(state.has_stalled, int(Status.STALLED), int(Status.ITERATION_LIMIT))
    status = jnp.where(is_nearest(robot, config, state), int(Status.NEAREST), status)
    status = jnp.where(state.is_near, int(Status.CONVERGED), status)
    return _Ends(jnp.moveaxis(state.coordinates, -1, 0), state.residual.cost, status, state.steps)


# The closed form's descents are quicker without XLA's fusion, and compiled in half the time; a network's are slower.
_descend_chain = jit_of_chains(_descend_rows, static_argnums=(0, 1))
_descend_layers = jax.jit(_descend_rows, static_argnums=(0, 1))


def _keep_better(best: _Best, rows: np.ndarray, ends: _Ends) -> _Best:
    """The nearest end of each row, where it is nearer than what was known."""
    winner = np.argmin(ends.cost, axis=1)
    won = jax.tree.map(lambda value: value[np.arange(len(rows)), winner], ends)
    is_better = won.cost <= best.cost[rows]
    kept = {name: getattr(best, name).copy() for name in ("coordinates", "cost", "status", "steps")}
    for name in ("coordinates", "cost", "status"):
        kept[name][rows[is_better]] = getattr(won, name)[is_better]
    kept["steps"][rows] += ends.steps.sum(axis=1)
    return _Best(**kept)


def _tighten(
    robot: Robot,
    model: PoseFunction | None,
    config: LeastSquaresConfig,
    candidates: Candidates,
    targets: np.ndarray,
    result: SolveResult,
) -> SolveResult:
    """Other answers for the solved rows with too little tension: of each, the one whose least loaded strand carries most.

    They are sought on the closed form, which says of tension what the model's answer next to it says, and costs less.
    """
    rows = np.flatnonzero(np.asarray(result.converged & ~(result.least_tension >= config.least_tension)))
    if len(rows) == 0 or config.least_tension == 0.0 or kind_of(robot).strand_tension is None:
        return result
    settings, shape = config.tension_round, (len(rows), config.tension_round.num_starts)
    nearest = nearest_candidates(candidates, config.descent.rotation_weight, targets[rows], 0, settings.num_starts)
    ends = _descend(robot, None, config, candidates.coordinates[nearest], targets[rows], settings.iterations)
    coordinates = ends.coordinates.reshape(-1, *ends.coordinates.shape[2:])
    tension = in_batches(functools.partial(_tension_rows, robot), config.batch_size, coordinates).reshape(shape)
    winner = np.argmax(np.where((ends.status == Status.CONVERGED) & (tension >= 0.0), tension, -1.0), axis=1)
    chosen = (np.arange(len(rows)), winner)
    best = _Best(ends.coordinates[chosen], ends.cost[chosen], ends.status[chosen], ends.steps.sum(axis=1))
    if model is not None:
        starts, iterations = best.coordinates[:, None], config.rounds[0].iterations
        descended = _descend(robot, model, config, starts, targets[rows], iterations)
        ends = jax.tree.map(lambda value: value[:, 0], descended)
        best = _Best(ends.coordinates, ends.cost, ends.status, best.steps + ends.steps)
    found = _evaluate(robot, model, config, targets[rows], best)
    is_better = found.converged & (found.least_tension > result.least_tension[rows])
    steps = result.steps.at[rows].add(found.steps)
    better, found = rows[np.asarray(is_better)], jax.tree.map(lambda value: value[np.asarray(is_better)], found)
    return jax.tree.map(lambda old, new: old.at[better].set(new), result, found).replace(steps=steps)


@jax.jit
def _tension_rows(robot: Robot, coordinates: jax.Array) -> jax.Array:
    return jax.vmap(lambda rows: least_tension(robot, lengths_of(robot, rows)))(coordinates)


def _evaluate(
    robot: Robot, model: PoseFunction | None, config: LeastSquaresConfig, targets: np.ndarray, best: _Best
) -> SolveResult:
    """The result, its errors recomputed by the model."""
    function = functools.partial(_evaluate_rows, config.descent, model, robot)
    result = in_batches(function, config.batch_size, targets, best.coordinates, best.steps, best.status)
    return jax.tree.map(jnp.asarray, result)


@functools.partial(jax.jit, static_argnums=0)
def _evaluate_rows(
    config: DescentConfig, model: PoseFunction | None, robot: Robot, targets, coordinates, steps, ended
) -> SolveResult:
    lengths = jax.vmap(lambda rows: lengths_of(robot, rows))(coordinates)
    tolerances = (config.position_tolerance, config.orientation_tolerance)
    result = describe_solution(robot, or_closed_form(robot, model), targets, lengths, tolerances, steps)
    is_open = (result.status == Status.ITERATION_LIMIT) & (ended != Status.CONVERGED)
    return dataclasses.replace(result, status=jnp.where(is_open, ended, result.status))
