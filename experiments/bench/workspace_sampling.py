"""Poses a second of the workspace's sampling kernel, and of the general forward kinematics beside it."""

import functools
import os
import time

os.environ["JAX_ENABLE_X64"] = "1"

import jax
import jax.numpy as jnp

from qjrl.provenance import provenance
from qjrl.robot import forward_kinematics, load_robot
from qjrl.studies.workspace.occupancy import ring_grid
from qjrl.studies.workspace.survey import reach_bound
from qjrl.studies.workspace.tip_clouds import BATCH, count_hits, in_float32, spatial_bends

ARMS = ("qj_2222", "qj_huang_4332")
BATCHES = 16
REPEATS = 3


def main() -> None:
    """Prints a line for each arm and law."""
    machine = provenance({}, None, None)["hardware"]
    print(f"machine: {machine['cpu']}, {machine['cores']} cores")
    for name in ARMS:
        robot = load_robot(name)
        rings = ring_grid(reach_bound(robot), 0.005, 4)
        rates = {law: best_rate(functools.partial(drain, robot, law, rings)) for law in ("spatial", "planar")}
        rates["forward_kinematics"] = best_rate(functools.partial(general, robot))
        for what, rate in rates.items():
            ratio = rate / rates["forward_kinematics"]
            print(f"{name:15} {what:20} {rate:12,.0f} poses/s   {ratio:6.1f} times the general one")


def drain(robot, law: str, rings) -> int:
    """Drawn, carried to the tip and counted in rings, float32."""
    return sum(size for size, _ in count_hits(robot, law, rings, jax.random.key(0), BATCHES * BATCH))


def general(robot) -> int:
    """The same bends carried to the tip by the general kinematics, float32, not counted."""
    jax.block_until_ready(_general(in_float32(robot), jax.random.key(0)))
    return BATCH


@jax.jit
def _general(robot, key):
    words = jax.random.bits(key, (BATCH, robot.num_segments), jnp.uint32)
    return jax.vmap(lambda row: forward_kinematics(robot, spatial_bends(robot, row))[:3])(words)


def best_rate(work) -> float:
    """Poses a second of the quickest of a few runs, after one that compiles."""
    work()
    rates = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        rates.append(work() / (time.perf_counter() - start))
    return max(rates)


if __name__ == "__main__":
    main()
