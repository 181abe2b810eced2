"""Throughput of the inverse-kinematics solvers, and what the closed-form Jacobian is worth; compilation is in no time."""

import time

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.provenance import provenance
from qjrl.robot import forward_kinematics, load_robot
from qjrl.robot.quaternion_arm.differential import tip_of
from qjrl.solvers import draw_candidates, solve_fabrik, solve_least_squares
from qjrl.studies.table3.protocol import CaseConfig, draw_targets

NUM_TARGETS, NUM_FABRIK, NUM_SINGLE, NUM_REPEATS = 8192, 1024, 50, 5


def best_seconds(function) -> float:
    """The shortest of some calls, after one that compiles."""
    function()
    times = []
    for _ in range(NUM_REPEATS):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    return min(times)


def bench_solvers(robot, candidates, largest_angle_deg: float) -> None:
    """Print rates, shares reached and ratios on targets of one range."""
    targets, _ = draw_targets(robot, CaseConfig(robot.name, largest_angle_deg), NUM_TARGETS, seed=0)
    solve = lambda rows: solve_least_squares(robot, rows, candidates=candidates)  # noqa: E731
    rate = NUM_TARGETS / best_seconds(lambda: solve(targets))
    fabrik_rate = NUM_FABRIK / best_seconds(lambda: solve_fabrik(robot, targets[:NUM_FABRIK]))
    single = best_seconds(lambda: [solve(targets[row : row + 1]) for row in range(NUM_SINGLE)]) / NUM_SINGLE
    reached = 100.0 * np.mean(solve(targets).converged)
    fabrik_reached = 100.0 * np.mean(solve_fabrik(robot, targets[:NUM_FABRIK]).converged)
    print(f"targets to ±{largest_angle_deg:g}°")
    print(f"  least squares, batch of {NUM_TARGETS}: {rate:10,.0f} poses/s, {reached:.2f} % reached")
    print(f"  least squares, one at a time: {1.0 / single:7,.0f} poses/s; batch / single = {rate * single:.1f}")
    print(f"  FABRIK, batch of {NUM_FABRIK}:        {fabrik_rate:10,.0f} poses/s, {fabrik_reached:.2f} % reached")
    print(f"  least squares / FABRIK = {rate / fabrik_rate:.1f}")


def bench_jacobian(robot, count: int = 512) -> None:
    """Print the ratio of two ways to the Jacobian of the tip."""
    vectors = jax.random.uniform(jax.random.key(0), (robot.num_segments, 2, count), minval=-0.5, maxval=0.5)
    rows = jnp.moveaxis(vectors, -1, 0)
    closed_form = jax.jit(tip_of)
    automatic = jax.jit(jax.vmap(jax.jacfwd(lambda bends: forward_kinematics(robot, bends))))
    ratio = best_seconds(lambda: automatic(rows)) / best_seconds(lambda: closed_form(robot, vectors))
    print(f"Jacobian of {count} poses: jax.jacfwd / closed form = {ratio:.1f} in time")


def main() -> None:
    """Print the machine, then everything."""
    jax.config.update("jax_enable_x64", True)
    machine = provenance({}, None, None)["hardware"]
    print(f"{machine['cpu']}, {machine['cores']} cores; jax {jax.__version__}")
    robot = load_robot("qj_2222")
    candidates = draw_candidates(robot)
    for largest_angle_deg in (30.0, 70.0):
        bench_solvers(robot, candidates, largest_angle_deg)
    bench_jacobian(robot)


if __name__ == "__main__":
    main()
