"""Inverse kinematics in one run on one machine: least squares and Adam on the same model, and a public solver.

    python experiments/bench/inverse_kinematics.py [outputs/default/forward_model]

Without an argument the model is a network of the shipped size fitted to the golden rows: as costly as any, less accurate,
which no number below depends on. The public solver is mink (extra `bench`), on an arm of seven hinges of about the same length.
"""

import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from qjrl import artifacts
from qjrl.config import conf_folder
from qjrl.control.inversion import IKConfig, solve_model, solve_nominal
from qjrl.deployment.compact_ik import CompactIKConfig, compact_ik
from qjrl.deployment.latency import measure_latency
from qjrl.learning.fitting import FitConfig
from qjrl.provenance import provenance
from qjrl.robot import cable_lengths, in_precision, load_robot
from qjrl.robot.forward_model import ForwardModelConfig, load_forward_model, pose_function
from qjrl.robot.model_fitting import fit_forward_model
from qjrl.robot.quaternion_arm.sampling import bends_from_unit_cube
from qjrl.solvers import AdamConfig, LeastSquaresConfig, draw_candidates, solve_adam, solve_least_squares

NUM_TARGETS, NUM_ADAM, NUM_SINGLE, NUM_REPEATS = 4096, 128, 300, 3
# Paper 000, section 4: 200 iterations at a rate of 0.05, best of random restarts.
ADAM = AdamConfig(num_candidates=8, num_retries=0)
POSITION_TOLERANCE, ORIENTATION_TOLERANCE = 1e-5, np.radians(0.01)
MINK_ITERATIONS = 200
HOME = np.array([0.0, 0.5, 0.0, -1.0, 0.0, 0.5, 0.0])


def the_model(robot):
    """A fitted forward model: of a run, or of the golden rows."""
    if len(sys.argv) > 1:
        return load_forward_model(Path(sys.argv[1]) / "model", robot)
    config = ForwardModelConfig(fit=FitConfig(epochs=20))
    rows = artifacts.load(conf_folder().parent / "data" / "golden")
    with tempfile.TemporaryDirectory() as folder:
        return fit_forward_model(robot, config, rows, 0, Path(folder))[0]


def reachable_poses(robot, pose, count: int) -> np.ndarray:
    """The model's poses of commands all over the workspace."""
    numbers = np.random.default_rng(1).random((count, robot.num_cables))
    reach = jax.jit(jax.vmap(lambda row: pose(cable_lengths(robot, bends_from_unit_cube(robot, row)))))
    return np.asarray(reach(jnp.asarray(numbers)))


def seconds_of(solve) -> float:
    """The shortest of some calls, after one that compiles."""
    solve()
    times = []
    for _ in range(NUM_REPEATS):
        start = time.perf_counter()
        jax.block_until_ready(solve())
        times.append(time.perf_counter() - start)
    return min(times)


def show(name: str, rate: float, result, note: str = "") -> None:
    """One line: rate, share solved, what the solver believes of its answers."""
    position, orientation = 1e3 * np.asarray(result.position_error), np.degrees(result.orientation_error)
    solved = (position <= 1e3 * POSITION_TOLERANCE) & (orientation <= np.degrees(ORIENTATION_TOLERANCE))
    print(
        f"  {name:34} {rate:10,.1f} targets/s, {100 * solved.mean():6.2f} % to 0.01 mm and 0.01°; "
        f"median {np.median(position):.2g} mm {np.median(orientation):.2g}°, p99 {np.quantile(position, 0.99):.2g} mm{note}"
    )


def bench_batches(robot, model, targets) -> None:
    """Least squares on both models, with and without the search for taut strands, which Adam does not have; the Adam of the
    paper on the first of the same targets."""
    few, rates = targets[:NUM_ADAM], []
    for name, tension in (("", 0.0), (", taut", LeastSquaresConfig().least_tension)):
        ik = IKConfig(least_squares=LeastSquaresConfig(least_tension=tension))
        ways = {
            "closed form": partial(solve_nominal, robot, targets, ik.least_squares, 0),
            "learned model": partial(solve_model, robot, targets, model, ik, 0),
        }
        for way, solve in ways.items():
            rates.append(len(targets) / seconds_of(solve))
            show(f"least squares, {way}{name}", rates[-1], solve())
        show("... on Adam's targets", rates[-1], solve_model(robot, few, model, ik, 0), " (rate of the whole batch)")
    adam = solve_adam(robot, few, model, ADAM)  # compiles, and gives the answers
    start = time.perf_counter()
    jax.block_until_ready(solve_adam(robot, few, model, ADAM))
    adam_rate = len(few) / (time.perf_counter() - start)
    show("Adam, learned model (paper)", adam_rate, adam)
    plain, taut = rates[1] / adam_rate, rates[3] / adam_rate
    print(f"  least squares / Adam, learned model: {plain:,.0f} times the rate, taut {taut:,.0f}")


def bench_single(robot, fitted, model, targets) -> None:
    """One target after the other, warm: through the package, and the function that is exported."""
    solver, inner = LeastSquaresConfig(), in_precision(robot, "float32")
    candidates = draw_candidates(robot, solver)
    compact = compact_ik(inner, pose_function(inner, fitted), CompactIKConfig(), 0)
    ways = {
        "closed form": lambda row: solve_least_squares(robot, row, None, solver, candidates),
        "learned model": lambda row: solve_least_squares(robot, row, None, solver, candidates, model),
    }
    for name, solve in ways.items():
        solve(targets[:1])
        show_latency(f"one target, {name}", [timed(lambda: solve(targets[row : row + 1])) for row in range(NUM_SINGLE)])  # noqa: B023
    file = measure_latency(jax.jit(jax.vmap(compact)), targets[0].astype(np.float32), NUM_SINGLE)
    print(f"  {'one target, exported function':34} median {file['median_ms']:.2f} ms, p99 {file['p99_ms']:.2f} ms")


def timed(call) -> float:
    """Seconds of a call."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def show_latency(name: str, seconds: list[float]) -> None:
    """Median and 99th percentile."""
    print(f"  {name:34} median {1e3 * np.median(seconds):.2f} ms, p99 {1e3 * np.quantile(seconds, 0.99):.2f} ms")


def seven_hinges() -> str:
    """A plain arm of seven hinges, 0.42 m long, turning and bending in alternation."""
    lines = ['<mujoco><compiler angle="radian"/><worldbody>']
    for number in range(7):
        axis, limit = ("0 0 1", 2.9) if number % 2 == 0 else ("0 1 0", 2.0)
        lines.append(
            f'<body pos="0 0 {0.06 if number else 0.0}"><joint axis="{axis}" range="-{limit} {limit}" limited="true"/>'
            '<geom type="capsule" fromto="0 0 0 0 0 0.06" size="0.015"/>'
        )
    lines.append('<site name="tip" pos="0 0 0.06"/>' + "</body>" * 7 + "</worldbody></mujoco>")
    return "".join(lines)


def bench_mink() -> None:
    """mink, one target after the other from one start, full steps (dt = 1), joint limits by its QP."""
    try:
        import mink  # pyright: ignore[reportMissingImports]
        import mujoco
    except ImportError:
        print("mink is not installed: pip install 'qjrl[bench]' to compare with it; skipped")
        return
    model = mujoco.MjModel.from_xml_string(seven_hinges())
    configuration, task = mink.Configuration(model), mink.FrameTask("tip", "site", 1.0, 0.1, lm_damping=1e-3)
    limits, random = [mink.ConfigurationLimit(model)], np.random.default_rng(0)
    seconds, solved, steps = [], [], []
    for _ in range(NUM_SINGLE):
        configuration.update(random.uniform(0.95 * model.jnt_range[:, 0], 0.95 * model.jnt_range[:, 1]))
        task.set_target(configuration.get_transform_frame_to_world("tip", "site"))
        start = time.perf_counter()
        is_solved, count = descend_from_home(mink, configuration, task, limits)
        seconds.append(time.perf_counter() - start)
        solved.append(is_solved)
        steps.append(count)
    print(f"  {'mink, 7 hinges, closed form':34} {NUM_SINGLE / sum(seconds):10,.1f} targets/s, {100 * np.mean(solved):.1f} % to "
          f"0.01 mm and 0.01° within {MINK_ITERATIONS} steps from one start, median {np.median(steps):.0f} steps")  # fmt: skip
    show_latency("one target, mink", seconds)
    show_latency("... of those that it solves", [one for one, good in zip(seconds, solved, strict=True) if good])


def descend_from_home(mink, configuration, task, limits) -> tuple[bool, int]:
    """Whether the target is reached to the tolerances, and after how many steps."""
    configuration.update(HOME)
    for number in range(MINK_ITERATIONS):
        configuration.integrate_inplace(mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits), 1.0)
        error = task.compute_error(configuration)
        if np.linalg.norm(error[:3]) <= POSITION_TOLERANCE and np.linalg.norm(error[3:]) <= ORIENTATION_TOLERANCE:
            return True, number + 1
    return False, MINK_ITERATIONS


def main() -> None:
    """Print the machine, then everything."""
    jax.config.update("jax_enable_x64", True)
    machine = provenance({}, None, None)["hardware"]
    robot = load_robot("qj_2222")
    fitted = the_model(robot)
    model = pose_function(robot, fitted)
    targets = reachable_poses(robot, model, NUM_TARGETS)
    print(
        f"{machine['cpu']}, {machine['cores']} cores; jax {jax.__version__}; qj_2222, {NUM_TARGETS} reachable targets"
    )
    bench_batches(robot, model, targets)
    bench_single(robot, fitted, model, targets)
    bench_mink()


if __name__ == "__main__":
    main()
