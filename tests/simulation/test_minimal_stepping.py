"""Stepping in minimal coordinates against C MuJoCo, and its own exact properties."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named
from statics import equilibria

from qjrl.robot import cable_lengths, joint_positions, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.stepping import MujocoStepper, Stepper


def MinimalStepper(arm, num_sims, timestep=0.005) -> Any:
    return make_stepper(arm, num_sims, EngineConfig("minimal", timestep))


ARM = arm_named("qj_22")
HOME = np.asarray(joint_positions(ARM, jnp.zeros((2, 2))))


def commands(bends):
    return np.array([strand_commands(ARM, cable_lengths(ARM, row)) for row in bends])


FAR = commands(np.array([[[0.3, 0.1], [-0.2, 0.2]], [[0.0, -0.5], [0.1, 0.4]], [[0.1, 0.0], [0.0, 0.0]]]))
NEAR = np.tile(commands(np.zeros((1, 2, 2))), (3, 1))
NOMINAL = PhysicalParameters.nominal(ARM, 3)
PARAMETERS = dataclasses.replace(
    NOMINAL,
    strand_damping_scale=np.array([1.0, 0.6, 2.0]),
    armature_scale=np.array([1.0, 2.0, 0.5]),
    gain_scale=np.array([1.0, 0.8, 1.25]),
)


def begun(stepper: Stepper, parameters: PhysicalParameters = PARAMETERS) -> Stepper:
    stepper.reset(np.arange(3), HOME, NEAR, parameters)
    return stepper


def ramp(stepper: Stepper, seconds: float, end: np.ndarray = FAR, duration: float = 1.0):
    """Home to `end` in `duration`, commands 50 times a second; the readout at the end."""
    for step in range(round(seconds / 0.02)):
        share = min(1.0, (step + 1) * 0.02 / duration)
        stepper.step(NEAR + share * (end - NEAR), round(0.02 / stepper.timestep))
    return stepper.read()


@pytest.fixture(scope="module")
def rested():
    """Both engines after 3 s."""
    return [ramp(begun(make(ARM, 3)), 3.0) for make in (MujocoStepper, MinimalStepper)]


def test_it_is_a_stepper():
    assert isinstance(MinimalStepper(ARM, 3), Stepper)


def test_it_rests_where_mujoco_rests(rested):
    mujoco, minimal = rested
    np.testing.assert_allclose(minimal.pose[:, :3], mujoco.pose[:, :3], atol=1e-5)
    np.testing.assert_allclose(minimal.pose[:, 3:], mujoco.pose[:, 3:], atol=1e-4)
    np.testing.assert_allclose(minimal.strand_tension, mujoco.strand_tension, atol=0.05)
    np.testing.assert_allclose(minimal.strand_lengths, mujoco.strand_lengths, atol=5e-6)
    np.testing.assert_allclose(minimal.joint_positions, mujoco.joint_positions, atol=1e-4)
    assert np.abs(minimal.joint_velocities).max() < 1e-4


def test_rest_does_not_depend_on_the_time_step(rested):
    for timestep in (0.004, 0.02):
        found = ramp(begun(MinimalStepper(ARM, 3, timestep)), 3.0)
        np.testing.assert_allclose(found.pose[:, :3], rested[1].pose[:, :3], atol=2e-6)


def test_gravity_follows_the_tilt():
    tilted = dataclasses.replace(NOMINAL, tilt=np.array([[0.1, 0.0], [0.0, 0.2], [-0.1, 0.1]]))
    mujoco, minimal = (ramp(begun(make(ARM, 3), tilted), 2.0) for make in (MujocoStepper, MinimalStepper))
    np.testing.assert_allclose(minimal.pose[:, :3], mujoco.pose[:, :3], atol=1e-5)


def test_payloads_and_unlike_strands_rest_where_they_rest_in_mujoco(rested):
    """50 g, 200 g, strands each of its own stiffness: they move the resting tip by tenths of a millimetre."""
    unlike = np.random.default_rng(0).uniform(0.7, 1.4, (1, ARM.num_strands))
    loaded = dataclasses.replace(
        PARAMETERS,
        payload=np.array([0.05, 0.2, 0.0]),
        strand_stiffness_scale=np.concatenate([np.ones((2, ARM.num_strands)), unlike]),
    )
    mujoco, minimal = (ramp(begun(make(ARM, 3), loaded), 3.0) for make in (MujocoStepper, MinimalStepper))
    np.testing.assert_allclose(minimal.pose[:, :3], mujoco.pose[:, :3], atol=2e-5)
    moved = np.linalg.norm(mujoco.pose[:, :3] - rested[0].pose[:, :3], axis=1)
    assert np.all(moved > 1e-4), moved


def test_friction_sticks_and_its_trace_is_that_of_mujoco():
    """Overshoot and come back: where the arm stays depends on the way, after 14 s as after 4 s, by about as much as in MuJoCo.

    By exactly as much it cannot be: what sticks where follows from the last tremble of each. The third arm, without
    friction, forgets the way.
    """
    rough = dataclasses.replace(NOMINAL, strand_friction=np.array([3.0, 3.0, 0.0]))
    traces = []
    for make in (MujocoStepper, MinimalStepper):
        found = []
        for overshoot in (1.0, 1.3):
            stepper = begun(make(ARM, 3), rough)
            ramp(stepper, 1.5, NEAR + overshoot * (FAR - NEAR))
            found += [ramp_on(stepper, 2.5), ramp_on(stepper, 10.0)]
        traces.append(found)
    between = []
    for found in traces:
        straight, straight_later, beyond, beyond_later = (pose[:, :3] for pose in found)
        after_4_s = np.linalg.norm(beyond - straight, axis=1)
        after_14_s = np.linalg.norm(beyond_later - straight_later, axis=1)
        assert after_4_s[:2].min() > 2e-4
        np.testing.assert_allclose(after_14_s[:2], after_4_s[:2], rtol=0.1)
        assert after_14_s[2] < 5e-6
        between.append(after_4_s[:2])
    assert np.all((between[1] < 2.5 * between[0]) & (between[0] < 2.5 * between[1])), between


def ramp_on(stepper: Stepper, seconds: float) -> np.ndarray:
    for _ in range(round(seconds / 0.02)):
        stepper.step(FAR, round(0.02 / stepper.timestep))
    return stepper.read().pose.copy()


def test_the_stop_holds():
    pulled = np.tile(commands(np.array([[[0.6, 0.4], [0.0, 0.0]]])), (3, 1))  # 92 degrees
    found = ramp(begun(MinimalStepper(ARM, 3)), 2.0, pulled)
    stop = ARM.config.joint.bend_limit_deg + ARM.config.joint.stop_margin_deg
    hinges = found.joint_positions.reshape(3, ARM.num_joints, -1)[..., :2]
    theta = np.degrees(2 * np.arccos(np.prod(np.cos(hinges), axis=-1)))
    assert theta.max() < stop + 0.1 and theta.max() > stop - 0.5
    assert np.abs(found.joint_velocities).max() < 1e-3


def test_it_goes_on_bit_for_bit():
    one = begun(MinimalStepper(ARM, 3))
    ramp(one, 0.4)
    kept = one.get_state()
    other = MinimalStepper(ARM, 3)
    other.set_state(kept)
    first, second = (ramp(stepper, 0.2) for stepper in (one, other))
    np.testing.assert_array_equal(first.pose, second.pose)
    np.testing.assert_array_equal(first.strand_tension, second.strand_tension)


def test_a_diverged_arm_is_flagged_and_the_others_go_on():
    stepper = begun(MinimalStepper(ARM, 3))
    bad = FAR.copy()
    bad[1] = np.nan
    assert ramp(stepper, 0.1, bad).is_sound.tolist() == [True, False, True]
    stepper.reset(np.array([1]), HOME, NEAR[:1], PhysicalParameters.nominal(ARM, 1))
    assert ramp(stepper, 0.1).is_sound.all()


def test_an_absurd_speed_counts_as_divergence_and_stays_that_until_the_reset():
    stepper: Any = begun(MinimalStepper(ARM, 3))
    moving = stepper._state.state.moving
    rates = moving.rates.at[1, 0, 0].set(1e6)
    stepper._state = stepper._state.replace(state=stepper._state.state.replace(moving=moving.replace(rates=rates)))
    for _ in range(2):
        assert ramp(stepper, 0.1).is_sound.tolist() == [True, False, True]
    assert np.isfinite(stepper.read().pose).all()
    begun(stepper)
    assert ramp(stepper, 0.1).is_sound.all()


@pytest.mark.parametrize(
    "name",
    [
        "qj_22",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("qj_2222", "qj_2222_spherical", "qj_huang_4332_480")),
    ],
)
def test_every_arm_rests_where_the_potential_energy_is_least(name):
    """Within 2 micrometres, float32's share of half a metre; C MuJoCo's rows leave 10."""
    arm = arm_named(name)
    bends = np.random.default_rng(3).uniform(-0.25, 0.25, (3, arm.num_segments, 2))
    lengths = np.array([cable_lengths(arm, row) for row in bends])
    start = np.array([joint_positions(arm, row) for row in bends])
    held = np.array([strand_commands(arm, row) for row in lengths])
    stepper = MinimalStepper(arm, 3)
    stepper.reset(np.arange(3), start, held, PhysicalParameters.nominal(arm, 3))
    stepper.step(held, 600)
    tips, tension = equilibria(arm, lengths)
    found = stepper.read()
    np.testing.assert_allclose(found.pose[:, :3], tips, atol=2e-6)
    np.testing.assert_allclose(found.strand_tension, tension, atol=0.02)
