"""The engine in MJX against C MuJoCo, as short as it compiles: two arms of one segment; more in `test_mjx_stepping`."""

import copy

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from arms import altered, over_rows, random_bends

from qjrl.robot import cable_lengths, joint_positions, robot_from_mapping, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_engine, make_stepper
from qjrl.simulation.payload import tip_body
from qjrl.simulation.settle_problem import SettleConfig

# `qj_22` takes over two minutes of CPU to compile.
ARM = robot_from_mapping(
    altered("qj_22", joints_per_segment=[2], cables__hole_angles_deg=[[0, 90]], cables__names=[[1, 2]])
)
NUM_SIMS, TIMESTEP = 2, 0.004
PARAMETERS = PhysicalParameters(
    strand_damping_scale=np.array([0.5, 2.0]),
    strand_friction=np.array([0.0, 1.5]),
    armature_scale=np.array([2.0, 0.5]),
    gain_scale=np.array([0.8, 1.25]),
    tilt=np.array([[0.08, 0.0], [0.0, -0.08]]),
    strand_stiffness_scale=np.random.default_rng(0).uniform(0.8, 1.2, (NUM_SIMS, ARM.num_strands)),
    payload=np.array([0.05, 0.0]),
)


@pytest.fixture(scope="module")
def steppers():
    """C MuJoCo and MJX, both at home."""
    both = (
        make_stepper(ARM, NUM_SIMS, SettleConfig(timestep=TIMESTEP)),
        make_stepper(ARM, NUM_SIMS, EngineConfig("mjx", TIMESTEP)),
    )
    home = np.asarray(joint_positions(ARM, jnp.zeros((ARM.num_segments, 2))))
    for stepper in both:
        held = np.asarray(strand_commands(ARM, jnp.zeros(ARM.num_cables)))
        stepper.reset(np.arange(NUM_SIMS), home, held, PARAMETERS)
    return both


def test_the_constants_derived_in_jax_are_those_of_c_mujoco(steppers):
    """`mj_setConst` of every arm: they scale how hard equality rows, stops and friction are."""
    physics, host = steppers[1]._state.physics, steppers[1]._engine.arm.model
    tip = tip_body(ARM, host, PARAMETERS.payload)
    for index in range(NUM_SIMS):
        one = copy.copy(host)
        one.dof_armature[:] = host.dof_armature * PARAMETERS.armature_scale[index]
        one.body_mass[-1], one.body_ipos[-1] = tip.mass[index], tip.centre[index]
        one.body_inertia[-1] = tip.inertia[index]
        mujoco.mj_setConst(one, mujoco.MjData(one))
        np.testing.assert_allclose(physics.joint_inverse_inertia[index], one.dof_invweight0, rtol=1e-3)
        np.testing.assert_allclose(physics.tendon_inverse_inertia[index], one.tendon_invweight0, rtol=1e-3)


def test_the_state_is_of_single_precision_whatever_the_process_uses():
    """Warp's kernels refuse float64, and MJX would derive it."""
    engine = make_engine(ARM, EngineConfig("mjx", TIMESTEP))
    assert jax.config.jax_enable_x64
    home = jax.eval_shape(engine.home, PARAMETERS)
    assert {leaf.dtype for leaf in jax.tree.leaves(home.physics)} == {np.dtype("float32")}


def test_mjx_begins_where_c_mujoco_does_and_moves_as_it_does(steppers):
    lengths = over_rows(cable_lengths, ARM, random_bends(ARM, NUM_SIMS, seed=1, share=0.3))
    expected, found = (stepper.read() for stepper in steppers)
    np.testing.assert_allclose(found.pose, expected.pose, atol=1e-6)
    np.testing.assert_allclose(found.strand_lengths, expected.strand_lengths, atol=1e-6)
    np.testing.assert_allclose(found.strand_tension, expected.strand_tension, atol=0.05)
    for step in range(1, 6):
        for stepper in steppers:
            stepper.step(over_rows(strand_commands, ARM, 0.1 * step * lengths), 5)
        expected, found = (stepper.read() for stepper in steppers)
        assert found.is_sound.all() and expected.is_sound.all()
        millimetres = 1e3 * np.linalg.norm((found.pose - expected.pose)[:, :3], axis=1)
        assert millimetres[0] < 0.02 and millimetres[1] < 0.5  # the second one has friction
    assert np.linalg.norm(expected.pose[:, :2], axis=1).min() > 1e-3  # it has moved
