"""MJX in Warp's kernels against C MuJoCo, on a CPU: the first call compiles them for minutes, later ones find them on disk."""

import importlib.util

import jax.numpy as jnp
import numpy as np
import pytest
from arms import over_rows, random_bends

from qjrl.config import ConfigError
from qjrl.robot import build_mjcf, cable_lengths, joint_positions, load_robot, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.simulation import SettleConfig, settle
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.stepping import MujocoStepper

ARM, NUM_SIMS, SUBSTEPS = load_robot("qj_2222"), 4, 5
NUM_RAMP, NUM_HELD = 20, 25
needs_warp = pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="pip install 'qjrl[warp]'")


def various_parameters():
    """Over the range of the randomisation, one arm without friction; payloads, unlike strands."""
    return PhysicalParameters(
        strand_damping_scale=np.array([0.5, 1.0, 2.0, 3.0]),
        strand_friction=np.array([0.0, 3.0, 1.5, 0.5]),
        armature_scale=np.array([2.0, 0.5, 1.0, 1.5]),
        gain_scale=np.array([0.8, 1.25, 1.1, 0.9]),
        tilt=np.array([[0.08, 0.0], [0.0, -0.08], [0.05, 0.05], [0.0, 0.0]]),
        strand_stiffness_scale=np.random.default_rng(0).uniform(0.8, 1.2, (NUM_SIMS, ARM.num_strands)),
        payload=np.array([0.05, 0.0, 0.1, 0.0]),
    )


def test_without_warp_one_line_says_what_to_install(monkeypatch):
    from qjrl.simulation.mjx_model import load_arm

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"simulation.backend: got mjx-warp, .* pip install 'qjrl\[warp\]'"):
        load_arm(build_mjcf(ARM), backend="mjx-warp")


@pytest.mark.slow
@needs_warp
def test_warp_rests_where_c_mujoco_rests():
    lengths = over_rows(cable_lengths, ARM, random_bends(ARM, NUM_SIMS, seed=1))
    expected, found = settle(ARM, lengths), settle(ARM, lengths, backend="mjx-warp")
    assert found.converged.all() and expected.converged.all()
    assert 1e3 * np.linalg.norm((found.pose - expected.pose)[:, :3], axis=1).max() < 0.05  # measured: 0.01
    assert np.abs(found.strand_tension - expected.strand_tension).max() < 0.1  # measured: 0.014


@pytest.mark.slow
@needs_warp
def test_warp_moves_as_c_mujoco_does():
    lengths = over_rows(cable_lengths, ARM, random_bends(ARM, NUM_SIMS, seed=1, share=0.5))
    home = np.asarray(joint_positions(ARM, jnp.zeros((ARM.num_segments, 2))))
    held = np.asarray(strand_commands(ARM, jnp.zeros(ARM.num_cables)))
    steppers = MujocoStepper(ARM, NUM_SIMS), make_stepper(ARM, NUM_SIMS, SettleConfig(backend="mjx-warp"))
    for stepper in steppers:
        stepper.reset(np.arange(NUM_SIMS), home, held, various_parameters())
    millimetres, jitter = [], []
    for step in range(1, NUM_RAMP + NUM_HELD + 1):
        commands = over_rows(strand_commands, ARM, min(1.0, step / NUM_RAMP) * lengths)
        for stepper in steppers:
            stepper.step(commands, SUBSTEPS)
        expected, found = (stepper.read() for stepper in steppers)
        assert found.is_sound.all()
        millimetres.append(1e3 * np.linalg.norm((found.pose - expected.pose)[:, :3], axis=1))
        jitter.append(np.abs(found.joint_velocities - expected.joint_velocities).mean(axis=1))
        np.testing.assert_allclose(found.strand_velocities, expected.strand_velocities, atol=1e-3)
    assert np.max(millimetres) < 0.2  # measured: 0.05, with friction of 3 N
    assert np.max(jitter) < 1e-3
    assert np.mean(jitter) < 2e-4
