"""MJX against C MuJoCo. One stepper for all tests: compiling it takes over a minute on two cores."""

import copy

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from arms import over_rows, random_bends

from qjrl.robot import cable_lengths, joint_positions, load_robot, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.simulation import SettleConfig, settle
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.payload import tip_body
from qjrl.simulation.stepping import MujocoStepper

pytestmark = pytest.mark.slow

ARM, NUM_SIMS = "qj_2222", 4
EVERYONE = np.arange(NUM_SIMS)
NUM_RAMP, NUM_HELD = 20, 5
SUBSTEPS = 5
"""Time steps of 4 ms in a control period of 20 ms."""


@pytest.fixture(scope="module")
def arm():
    return load_robot(ARM)


@pytest.fixture(scope="module")
def mjx(arm):
    return make_stepper(arm, NUM_SIMS, SettleConfig(backend="mjx"))


@pytest.fixture(scope="module")
def lengths(arm):
    """(4, cables) [m] of bends up to half the limit: 0.4 s there at about the motors' speed."""
    return over_rows(cable_lengths, arm, random_bends(arm, NUM_SIMS, seed=1, share=0.5))


def various_parameters():
    """Four arms over the whole range of the randomisation, one of them without friction; payloads, unlike strands."""
    return PhysicalParameters(
        strand_damping_scale=np.array([0.5, 1.0, 2.0, 3.0]),
        strand_friction=np.array([0.0, 3.0, 1.5, 0.5]),
        armature_scale=np.array([2.0, 0.5, 1.0, 1.5]),
        gain_scale=np.array([0.8, 1.25, 1.1, 0.9]),
        tilt=np.array([[0.08, 0.0], [0.0, -0.08], [0.05, 0.05], [0.0, 0.0]]),
        strand_stiffness_scale=np.random.default_rng(0).uniform(0.8, 1.2, (NUM_SIMS, load_robot(ARM).num_strands)),
        payload=np.array([0.05, 0.0, 0.1, 0.0]),
    )


def begin(stepper, arm):
    home = np.asarray(joint_positions(arm, jnp.zeros((arm.num_segments, 2))))
    stepper.reset(EVERYONE, home, np.asarray(strand_commands(arm, jnp.zeros(arm.num_cables))), various_parameters())


def commands(arm, lengths, step):
    share = min(1.0, step / NUM_RAMP)
    return over_rows(strand_commands, arm, share * lengths)


def travel(stepper, arm, lengths, first=1, last=NUM_RAMP + NUM_HELD):
    """Readouts after every control step from `first` to `last`, copied."""
    readouts = []
    for step in range(first, last + 1):
        stepper.step(commands(arm, lengths, step), SUBSTEPS)
        readout = stepper.read()
        readouts.append({name: np.array(value) for name, value in vars(readout).items()})
    return {name: np.stack([readout[name] for readout in readouts]) for name in readouts[0]}


def test_mjx_moves_as_c_mujoco_does(arm, mjx, lengths):
    reference = MujocoStepper(arm, NUM_SIMS)
    begin(reference, arm)
    begin(mjx, arm)
    np.testing.assert_allclose(mjx.read().pose, reference.read().pose, atol=1e-6)
    expected, found = travel(reference, arm, lengths), travel(mjx, arm, lengths)
    assert found["is_sound"].all() and expected["is_sound"].all()
    tip_mm = 1e3 * np.linalg.norm((found["pose"] - expected["pose"])[..., :3], axis=-1)
    is_free = various_parameters().strand_friction == 0.0
    assert tip_mm[:, is_free].max() < 0.02  # measured: 0.003
    assert tip_mm.max() < 0.5  # dry friction, softer than in C and in float32; measured: 0.32


def test_mjx_keeps_still_what_rests_in_c_mujoco(arm, mjx, lengths):
    """Without balanced forces, see `mjx_model.balanced`, the mean was 2.6e-3 rad/s and the largest 4e-2."""
    rest = settle(arm, lengths)
    held = over_rows(strand_commands, arm, lengths)
    mjx.reset(EVERYONE, rest.joint_positions, held, PhysicalParameters.nominal(arm, NUM_SIMS))
    speeds = []
    for _ in range(25):
        mjx.step(held, SUBSTEPS)
        speeds.append(np.abs(mjx.read().joint_velocities).mean(axis=1))
    assert np.mean(speeds) < 2e-4
    assert np.max(speeds) < 2e-3
    assert 1e3 * np.abs(mjx.read().pose[:, :3] - rest.pose[:, :3]).max() < 0.02


def test_mjx_goes_on_bit_for_bit_from_its_state(arm, mjx, lengths):
    begin(mjx, arm)
    travel(mjx, arm, lengths, last=3)
    state = mjx.get_state()
    through = travel(mjx, arm, lengths, first=4, last=6)
    begin(mjx, arm)
    mjx.set_state(state)
    again = travel(mjx, arm, lengths, first=4, last=6)
    for name, expected in through.items():
        np.testing.assert_array_equal(again[name], expected, err_msg=name)
    assert all(value.dtype != object for value in state.values())


@pytest.mark.parametrize("speed", [1e12, 1e6])
def test_a_simulation_that_diverges_is_flagged_until_its_reset_and_leaves_the_others_alone(arm, mjx, lengths, speed):
    begin(mjx, arm)
    travel(mjx, arm, lengths, last=2)
    state = mjx.get_state()
    expected = travel(mjx, arm, lengths, first=3, last=4)
    mjx.set_state(state)
    moving = mjx._state.state.moving
    faster = moving.replace(joint_velocities=moving.joint_velocities.at[1].set(speed))
    mjx._state = mjx._state.replace(state=mjx._state.state.replace(moving=faster))
    found = travel(mjx, arm, lengths, first=3, last=4)
    assert found["is_sound"].tolist() == [[True, False, True, True]] * 2
    others = [0, 2, 3]
    np.testing.assert_array_equal(found["pose"][:, others], expected["pose"][:, others])
    assert np.isfinite(found["pose"]).all()
    begin(mjx, arm)
    assert mjx.read().is_sound.all()


def test_the_constants_derived_in_jax_are_those_of_c_mujoco(arm, mjx):
    """`mj_setConst` of every arm: they scale how hard equality rows, stops and friction are."""
    begin(mjx, arm)
    physics = mjx._state.physics
    host, parameters = mjx._engine.arm.model, various_parameters()
    for index in range(NUM_SIMS):
        one = copy.copy(host)
        one.dof_armature[:] = host.dof_armature * parameters.armature_scale[index]
        tip = tip_body(arm, host, parameters.payload)
        one.body_mass[-1], one.body_ipos[-1] = tip.mass[index], tip.centre[index]
        one.body_inertia[-1] = tip.inertia[index]
        mujoco.mj_setConst(one, mujoco.MjData(one))
        np.testing.assert_allclose(physics.joint_inverse_inertia[index], one.dof_invweight0, rtol=1e-3)
        np.testing.assert_allclose(physics.tendon_inverse_inertia[index], one.tendon_invweight0, rtol=1e-3)
