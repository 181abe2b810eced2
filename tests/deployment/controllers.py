"""A controller of the two-segment arm with feedback, dither and an untrained policy that does something; its rehearsal."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from arms import arm_named, over_rows, random_bends

from qjrl.control.controller import observation, prepare
from qjrl.control.deployable import ControllerFunctions, controller_functions
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.motors import DitherConfig
from qjrl.control.simulated_arm import SimulatedArm, rehearse
from qjrl.deployment.controller import deployed_controller
from qjrl.deployment.controller_export import ControllerExportConfig, export_files
from qjrl.deployment.controller_parity import Rehearsal
from qjrl.learning.ppo.policy import Policy
from qjrl.robot import cable_lengths, forward_kinematics, in_precision

ARM = arm_named("qj_22")
STEPS, PERIOD = 60, 0.02
CONFIG = EnvironmentConfig(episode_steps=STEPS, latest_arrival=0.4, scored_time=0.2, dither=DitherConfig(decay=0.1))
FILES = ControllerExportConfig(onnx=False)


@functools.cache
def targets() -> tuple[np.ndarray, np.ndarray]:
    """Two poses near home and the closed form's commands."""
    bends = random_bends(ARM, 2, 0, 0.1)
    return np.array(over_rows(forward_kinematics, ARM, bends)), np.array(over_rows(cable_lengths, ARM, bends))


@functools.cache
def policy() -> Policy:
    """Random weights, so that every number of an observation counts."""
    task = jnp.zeros(9), jnp.zeros(ARM.num_cables), jnp.zeros((ARM.num_segments, 2))
    seen = jax.eval_shape(
        lambda *task: observation(CONFIG.controller, ARM, prepare(CONFIG.controller, ARM, *task)), *task
    )
    sizes, rng = (len(seen), 16, 12), np.random.default_rng(0)
    layers = {
        f"hidden_{index}": {
            "kernel": rng.normal(0.0, 0.3, sizes[index : index + 2]).astype(np.float32),
            "bias": np.zeros(sizes[index + 1], np.float32),
        }
        for index in range(2)
    }
    return Policy(layers, np.zeros(sizes[0], np.float32), np.ones(sizes[0], np.float32), "swish", 10.0)


def arm(seed: int = 0) -> SimulatedArm:
    return SimulatedArm(ARM, CONFIG.randomisation, 0.004, seed)


@functools.cache
def live() -> ControllerFunctions:
    """The package's controller, compiled."""
    functions = controller_functions(CONFIG.controller, ARM, policy())
    return ControllerFunctions(jax.jit(functions.begin), jax.jit(functions.step))


@functools.cache
def rehearsal() -> Rehearsal:
    plant, episodes = arm(), []
    for row, (target, lengths) in enumerate(zip(*targets(), strict=True)):
        plant.home(row)
        episodes.append(rehearse(live(), plant, target, lengths, STEPS, 5))
    return Rehearsal(*targets(), *map(np.stack, zip(*episodes, strict=True)))


@functools.cache
def deployed():
    """The functions in single precision, with their ports."""
    inner, trained = in_precision(ARM, "float32"), policy()
    with jax.enable_x64(False):
        functions = controller_functions(CONFIG.controller, inner, trained)
        return deployed_controller(inner, functions.begin, functions.step, "float32")


@functools.cache
def exported():
    """The StableHLO files, checked."""
    return export_files(ARM, deployed(), FILES, rehearsal())
