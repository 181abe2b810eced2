"""One randomised arm in C MuJoCo with its encoders, as a controller meets it: read, hold a command, let time pass."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.control.deployable import ControllerFunctions
from qjrl.control.faults import Faults, draw_faults, transmit
from qjrl.control.randomisation import RandomisationConfig, draw_parameters
from qjrl.control.sensors import read_encoders
from qjrl.robot import configuration_from_joint_positions, joint_positions, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.robot.verbs import Robot, home
from qjrl.simulation.stepping import MujocoStepper


class SimulatedArm:
    """An arm whose parameters are drawn anew at every `home`, the noise of its encoders on."""

    def __init__(self, robot: Robot, randomisation: RandomisationConfig, timestep: float, seed: int):
        self.timestep = timestep
        self.stepper = MujocoStepper(robot, 1, timestep, num_threads=1)
        self._robot, self._key = robot, jax.random.key(seed)
        self._draw = jax.jit(partial(_draw, randomisation, robot))
        self._transmit = jax.jit(partial(_transmit, robot))
        self._home = np.asarray(joint_positions(robot, home(robot)))[None]
        self._sense = jax.jit(partial(_sense, robot, randomisation.encoder_noise_deg))
        self.home(0)

    def home(self, number: int) -> None:
        """At rest at home, with the parameters and the noise of episode `number`."""
        key_arm, self._noise = jax.random.split(jax.random.fold_in(self._key, number))
        drawn, self._faults = self._draw(key_arm)
        values = jax.tree.map(lambda value: np.asarray(value)[None], drawn)
        self.hold(np.zeros(self._robot.num_cables))
        self.stepper.reset(np.arange(1), self._home, self._held, values)

    def read(self) -> np.ndarray:
        """The encoders' estimate (segments, 2) [rad] now."""
        self._noise, key = jax.random.split(self._noise)
        return np.asarray(self._sense(self.stepper.read().joint_positions[0], self._faults.working_encoders, key))

    def hold(self, lengths: np.ndarray) -> None:
        """Give the motors cable lengths (num_cables,) [m]; once a control period, if it has a delay."""
        self._faults, strands = self._transmit(self._faults, np.asarray(lengths, np.float64))
        self._held = np.asarray(strands)[None]

    def advance(self, num_steps: int) -> None:
        """Let the physics run that many time steps."""
        if num_steps > 0:
            self.stepper.step(self._held, num_steps)

    @property
    def pose(self) -> np.ndarray:
        """(9,) of the tip, as only the simulation knows it."""
        return self.stepper.read().pose[0].copy()

    @property
    def joint_positions(self) -> np.ndarray:
        """(nq,) [rad, m]."""
        return self.stepper.read().joint_positions[0].copy()

    @property
    def is_finite(self) -> bool:
        """Whether the simulation is sound."""
        return bool(self.stepper.read().is_sound[0])


def rehearse(
    functions: ControllerFunctions,
    arm: SimulatedArm,
    target: np.ndarray,
    base_lengths: np.ndarray,
    steps: int,
    substeps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """What the package's own controller reads and commands in an episode from where `arm` is: readings (steps, segments, 2)
    [rad] and commands (steps, num_cables) [m].

    Args:
        functions: compiled.
        substeps: time steps of the physics in a control period.
    """
    reading = arm.read()
    state = functions.begin(jnp.asarray(target), jnp.asarray(base_lengths), jnp.asarray(reading))
    readings, commands = [], []
    for _ in range(steps):
        state = functions.step(state, jnp.asarray(reading))
        readings.append(reading)
        commands.append(np.asarray(state["command"]))
        arm.hold(commands[-1])
        arm.advance(substeps)
        reading = arm.read()
    return np.stack(readings), np.stack(commands)


def _draw(randomisation: RandomisationConfig, robot: Robot, key: jax.Array) -> tuple[PhysicalParameters, Faults]:
    key_parameters, key_faults = jax.random.split(key)
    faults = draw_faults(randomisation, robot, key_faults, jnp.zeros(robot.num_cables))
    return draw_parameters(randomisation, robot, key_parameters), faults


def _transmit(robot: Robot, faults: Faults, lengths: jax.Array) -> tuple[Faults, jax.Array]:
    faults = transmit(faults, lengths)
    return faults, strand_commands(robot, faults.held)


def _sense(robot: Robot, noise_deg: float, positions: jax.Array, working: jax.Array, key: jax.Array) -> jax.Array:
    return read_encoders(robot, configuration_from_joint_positions(robot, positions), noise_deg, key, working)
