"""Time of one arm's time step in minimal coordinates, on one core, and of its equations of motion alone."""

import os
import time

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.provenance import provenance
from qjrl.robot import load_robot
from qjrl.robot.quaternion_arm.dynamics import Load, equations_of_motion
from qjrl.robot.quaternion_arm.minimal_step import MinimalState, Physics, minimal_steps
from qjrl.xla_options import CPU_COMPILER_OPTIONS

ROBOT, TIMESTEP, NUM_STEPS, REPEATS = "qj_2222", 0.005, 4, 25


def main() -> None:
    """Arms with random parameters, in random motion; the median of many calls and the least."""
    arm = load_robot(ROBOT)
    print(f"{ROBOT} on {provenance({}, None, None)['hardware']['cpu']}, {NUM_STEPS} steps of {TIMESTEP:g} s a call")
    for batch in (512, 2048):
        physics, state, commands = _problem(arm, batch)
        step = (arm, physics, state, commands, np.float32(TIMESTEP), np.int32(NUM_STEPS))
        looked = (arm, physics.load, state.half_angles, state.rates)
        for name, function, arguments, steps in (
            ("step", minimal_steps, step, NUM_STEPS),
            ("equations of motion", equations_of_motion, looked, 1),
        ):
            began = time.process_time()
            compiled = jax.jit(function, compiler_options=CPU_COMPILER_OPTIONS).lower(*arguments).compile()
            took = time.process_time() - began
            jax.block_until_ready(compiled(*arguments))
            times = [1e6 / batch / steps * _seconds(compiled, arguments) for _ in range(REPEATS)]
            print(
                f"  {batch:5d} arms, {name:<20} {np.median(times):6.2f} us an arm and step, least {min(times):6.2f}; "
                f"compiled in {took:.1f} s of CPU"
            )


def _seconds(compiled, arguments) -> float:
    began = time.perf_counter()
    jax.block_until_ready(compiled(*arguments))
    return time.perf_counter() - began


def _problem(arm, batch: int) -> tuple[Physics, MinimalState, jax.Array]:
    random, segments = np.random.default_rng(0), arm.num_segments
    single = lambda values: jnp.asarray(values, jnp.float32)  # noqa: E731
    gravity = np.array(arm.config.mechanics.gravity)[:, None] + random.normal(size=(3, batch))
    load = Load(single(gravity), single(random.uniform(0.5, 2.0, batch)), single(random.uniform(0.0, 0.1, batch)))
    stiffness = float(arm.strand_stiffness) * random.uniform(0.8, 1.2, (arm.num_strands, batch))
    damping, friction = 50.0 * random.uniform(0.5, 2.0, batch), random.uniform(0.0, 3.0, batch)
    angles, rates = random.uniform(-0.3, 0.3, (segments, 2, batch)), 0.3 * random.normal(size=(segments, 2, batch))
    state = MinimalState(single(angles), single(rates), jnp.zeros((arm.num_strands + segments, batch), jnp.float32))
    strands = jax.jit(equations_of_motion, compiler_options=CPU_COMPILER_OPTIONS)(
        arm, load, state.half_angles, state.rates
    ).strands
    pull = float(arm.pretension / arm.strand_stiffness) + 2e-4 * random.normal(size=strands.shape)
    return Physics(load, single(stiffness), single(damping), single(friction)), state, strands - single(pull)


if __name__ == "__main__":
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    main()
