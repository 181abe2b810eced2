"""Control steps a second of 512 randomised arms: C MuJoCo against the equations of motion in minimal coordinates."""

import time

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.control.randomisation import RandomisationConfig, draw_parameters
from qjrl.provenance import provenance
from qjrl.robot import cable_lengths, joint_positions, load_robot, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.robot.quaternion_arm.arm import require_arm
from qjrl.robot.quaternion_arm.sampling import uniform_bends
from qjrl.robot.verbs import Robot
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.stepping import MujocoStepper, Stepper

ROBOT, NUM_ARMS, NUM_STEPS, CONTROL_PERIOD, RAMP_STEPS = "qj_2222", 512, 40, 0.02, 100


def randomised(robot: Robot, count: int) -> PhysicalParameters:
    """Physical parameters as the policy trains with."""
    keys = jax.random.split(jax.random.key(0), count)
    drawn = jax.vmap(lambda key: draw_parameters(RandomisationConfig(), robot, key))(keys)
    return jax.tree.map(np.asarray, drawn)


def minimal(robot: Robot, timestep: float) -> Stepper:
    """The engine in minimal coordinates."""
    return make_stepper(robot, NUM_ARMS, EngineConfig("minimal", timestep))


def rates(
    robot: Robot, stepper: Stepper, start: np.ndarray, home: np.ndarray, commands: np.ndarray
) -> tuple[float, float]:
    """Control steps a second, by clock and by CPU time, of arms on their way from home."""
    stepper.reset(np.arange(NUM_ARMS), start, home, randomised(robot, NUM_ARMS))
    substeps = round(CONTROL_PERIOD / stepper.timestep)
    stepper.step(np.tile(home, (NUM_ARMS, 1)), substeps)
    stepper.read()
    clock, cpu = time.perf_counter(), time.process_time()
    for step in range(NUM_STEPS):
        stepper.step(home + (step + 1) / RAMP_STEPS * (commands - home), substeps)
        stepper.read()
    count = NUM_STEPS * NUM_ARMS
    return count / (time.perf_counter() - clock), count / (time.process_time() - cpu)


def main() -> None:
    """Both engines on the same arms and commands."""
    robot = require_arm(load_robot(ROBOT), ROBOT)
    jax.config.update("jax_enable_x64", True)
    bends = jax.vmap(lambda key: uniform_bends(robot, key))(jax.random.split(jax.random.key(1), NUM_ARMS))
    commands = np.asarray(jax.vmap(lambda row: strand_commands(robot, cable_lengths(robot, row)))(bends))
    home = np.asarray(strand_commands(robot, jnp.zeros(robot.num_cables)))
    start = np.asarray(joint_positions(robot, jnp.zeros((robot.num_segments, 2))))
    machine = provenance({}, None, None)["hardware"]
    print(f"{NUM_ARMS} arms {ROBOT} on {machine['cores']} cores, {machine['cpu']}")
    found = {}
    for name, stepper in (
        ("C MuJoCo, 4 ms", MujocoStepper(robot, NUM_ARMS)),
        *((f"minimal coordinates, {ms} ms", minimal(robot, 1e-3 * ms)) for ms in (4, 5, 10, 20)),
    ):
        found[name] = rates(robot, stepper, start, home, commands)
        clock, cpu = found[name]
        ratio = cpu / found["C MuJoCo, 4 ms"][1]
        print(
            f"  {name:<28} {clock:8,.0f} control steps/s, {1e6 / cpu:6.0f} us of CPU each, {ratio:5.1f} times C MuJoCo's"
        )


if __name__ == "__main__":
    main()
