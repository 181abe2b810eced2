from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, random_bends

from qjrl.robot import cable_lengths, joint_positions, strand_commands
from qjrl.robot.plant import PhysicalParameters
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.settling import settle
from qjrl.simulation.stepping import MujocoStepper

STATE = ("joint_positions", "joint_velocities", "strand_lengths", "strand_velocities", "strand_tension", "pose")


def commands_of(arm, bends):
    """Rest lengths of the strands (n, strands) for nominal bends (n, segments, 2)."""
    return np.asarray(jax.vmap(lambda row: strand_commands(arm, cable_lengths(arm, row)))(jnp.asarray(bends)))


def begin(stepper, arm, parameters=None, ids=None):
    """Put simulations at rest at home."""
    ids = np.arange(stepper.num_sims) if ids is None else ids
    home = jnp.zeros((arm.num_segments, 2))
    parameters = parameters or PhysicalParameters.nominal(arm, len(ids))
    stepper.reset(ids, np.asarray(joint_positions(arm, home)), commands_of(arm, home[None])[0], parameters)


def snapshot(stepper, ids: Any = slice(None)):
    readout = stepper.read()
    return {name: np.array(getattr(readout, name))[ids] for name in STATE}


def assert_same(one, other):
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.fixture(scope="module")
def arm():
    return arm_named("qj_22")


# One simulation a variation; each parameter alone, so that none can hide behind another.
VARIATIONS = [
    "nominal",
    "damping",
    "armature",
    "gain",
    "tilt",
    "friction",
    "friction_from_beyond",
    "nominal_from_beyond",
]


@pytest.fixture(scope="module")
def varied():
    """Tips (n, 3) of the paper's arm, 0.3 s on the way to a bent pose and after it has come to rest there."""
    arm, count = arm_named("qj_2222"), len(VARIATIONS)
    parameters = PhysicalParameters.nominal(arm, count)
    parameters.strand_damping_scale[1] = 3.0
    parameters.armature_scale[2] = 2.0
    parameters.gain_scale[3] = 0.8
    parameters.tilt[4] = [np.radians(5.0), 0.0]
    parameters.strand_friction[5:7] = 2.0
    bends = 0.6 * random_bends(arm, 1, seed=3)
    stepper = MujocoStepper(arm, count)
    begin(stepper, arm, parameters)
    goal = np.repeat(commands_of(arm, bends), count, axis=0)
    beyond = goal.copy()
    beyond[6:] = commands_of(arm, 1.3 * bends)
    for share in np.linspace(0.0, 1.0, 60):  # as the motors would
        stepper.step(commands_of(arm, np.zeros_like(bends)) * (1 - share) + beyond * share, 5)
    moving = snapshot(stepper)["pose"][:, :3]
    for share in np.linspace(0.0, 1.0, 60):
        stepper.step(beyond * (1 - share) + goal * share, 5)
    stepper.step(goal, 900)
    readout = stepper.read()
    assert readout.is_sound.all()
    return (
        dict(zip(VARIATIONS, moving, strict=True)),
        dict(zip(VARIATIONS, readout.pose[:, :3].copy(), strict=True)),
        goal[0],
        bends,
    )


def distance(tips, one, other="nominal"):
    return 1e3 * np.linalg.norm(tips[one] - tips[other])


def test_damping_changes_the_way_and_not_where_the_arm_rests(varied):
    moving, at_rest, *_ = varied
    assert distance(moving, "damping") > 0.01
    assert distance(at_rest, "damping") < 0.02


def test_armature_changes_the_way_and_not_where_the_arm_rests(varied):
    moving, at_rest, *_ = varied
    assert distance(moving, "armature") > 0.01
    assert distance(at_rest, "armature") < 0.02


def test_the_strands_gain_moves_the_resting_tip_by_about_a_millimetre(varied):
    assert 0.2 < distance(varied[1], "gain") < 3.0  # spec, section 5: 0.9 mm at x0.8


def test_friction_sticks_and_remembers_the_approach(varied):
    _, at_rest, *_ = varied
    assert distance(at_rest, "nominal_from_beyond") < 0.02
    assert distance(at_rest, "friction", "friction_from_beyond") > 0.3


def test_a_tilted_base_moves_the_upright_tip_by_half_a_millimetre():
    arm = arm_named("qj_2222")
    parameters = PhysicalParameters.nominal(arm, 3)
    parameters.tilt[1] = [np.radians(5.0), 0.0]
    parameters.tilt[2] = [0.0, np.radians(5.0)]
    stepper = MujocoStepper(arm, 3)
    begin(stepper, arm, parameters)
    stepper.step(commands_of(arm, np.zeros((3, 4, 2))), 750)
    tips = 1e3 * stepper.read().pose[:, :3]
    assert 0.3 < np.linalg.norm(tips[1] - tips[0]) < 0.8  # spec, section 5: 0.5 mm
    assert 0.3 < np.linalg.norm(tips[2] - tips[0]) < 0.8
    # Gravity turned about x pulls along y, and the other way round.
    assert np.argmax(np.abs((tips[1] - tips[0])[:2])) == 1 and np.argmax(np.abs((tips[2] - tips[0])[:2])) == 0


def test_the_arm_comes_to_rest_where_settling_says(varied):
    arm = arm_named("qj_2222")
    *_, bends = varied
    lengths = jax.vmap(lambda row: cable_lengths(arm, row))(jnp.asarray(bends))
    expected = settle(arm, np.asarray(lengths)).pose[0, :3]
    assert 1e3 * np.linalg.norm(varied[1]["nominal"] - expected) < 0.02


def test_a_strand_pulls_what_the_readout_says(arm):
    stepper = MujocoStepper(arm, 1)
    begin(stepper, arm)
    readout = stepper.read()
    np.testing.assert_allclose(readout.strand_tension[0], arm.config.strands.pretension, rtol=1e-6)
    assert readout.strand_lengths.shape == readout.strand_velocities.shape == (1, arm.num_strands)


def test_a_reset_leaves_no_trace_in_its_own_simulation_and_none_in_the_others(arm):
    bends = random_bends(arm, 3, seed=1, share=0.5)
    commands = commands_of(arm, bends)
    touched, untouched, fresh = (MujocoStepper(arm, 3) for _ in range(3))
    for stepper in (touched, untouched, fresh):
        begin(stepper, arm)
    touched.step(commands, 40)
    untouched.step(commands, 40)
    parameters = PhysicalParameters.nominal(arm, 1)
    parameters.gain_scale[:] = 0.9
    begin(touched, arm, parameters, np.array([1]))
    assert_same(snapshot(touched, [0, 2]), snapshot(untouched, [0, 2]))
    begin(fresh, arm, parameters, np.array([1]))
    assert_same(snapshot(touched, [1]), snapshot(fresh, [1]))
    for stepper in (touched, untouched, fresh):
        stepper.step(commands, 25)
    assert_same(snapshot(touched, [0, 2]), snapshot(untouched, [0, 2]))
    assert_same(snapshot(touched, [1]), snapshot(fresh, [1]))


def test_the_number_of_threads_changes_no_bit(arm):
    commands = commands_of(arm, random_bends(arm, 5, seed=2, share=0.8))
    found = []
    for num_threads in (1, 2, 3):
        stepper = MujocoStepper(arm, 5, num_threads=num_threads)
        begin(stepper, arm)
        stepper.step(commands, 60)
        found.append(snapshot(stepper))
    assert_same(found[0], found[1])
    assert_same(found[0], found[2])


def test_going_back_to_a_state_repeats_what_came_after_bit_for_bit(arm):
    commands = commands_of(arm, random_bends(arm, 2, seed=4, share=0.8))
    parameters = PhysicalParameters.nominal(arm, 2)
    for field, values in (("strand_damping_scale", [0.5, 3]), ("armature_scale", [2, 0.5]), ("gain_scale", [0.8, 1.2])):
        getattr(parameters, field)[:] = values
    parameters.strand_friction[:] = [0.0, 3.0]
    parameters.tilt[:] = [[0.05, 0.0], [0.0, -0.05]]
    stepper, other = MujocoStepper(arm, 2), MujocoStepper(arm, 2)
    begin(stepper, arm, parameters)
    stepper.step(commands, 30)
    state = stepper.get_state()
    stepper.step(commands, 30)
    begin(other, arm)
    other.step(commands[::-1], 7)
    other.set_state(state)
    other.step(commands, 30)
    assert_same(snapshot(stepper), snapshot(other))
    assert all(array.dtype != object for array in state.values())


def test_a_state_read_is_a_copy(arm):
    stepper = MujocoStepper(arm, 2)
    begin(stepper, arm)
    state = stepper.get_state()
    before = {name: array.copy() for name, array in state.items()}
    parameters = PhysicalParameters.nominal(arm, 2)
    parameters.gain_scale[:] = 0.5
    begin(stepper, arm, parameters)
    stepper.step(commands_of(arm, random_bends(arm, 2, seed=4)), 10)
    assert_same(before, state)


@pytest.mark.parametrize("poison", ["command", "position"])
def test_a_diverged_simulation_is_told_apart_spoils_no_other_and_heals_when_reset(arm, poison):
    commands = commands_of(arm, random_bends(arm, 3, seed=5, share=0.5))
    poisoned, sound = MujocoStepper(arm, 3), MujocoStepper(arm, 3)
    begin(poisoned, arm)
    begin(sound, arm)
    broken = commands.copy()
    if poison == "command":
        broken[1, 0] = np.nan
    else:
        position = np.full(arm.num_joints * 5, 1e9)[: poisoned.model.nq]
        poisoned.reset(np.array([1]), position, commands[1], PhysicalParameters.nominal(arm, 1))
    poisoned.step(broken, 10)
    sound.step(commands, 10)
    assert poisoned.read().is_sound.tolist() == [True, False, True] and sound.read().is_sound.all()
    assert_same(snapshot(poisoned, [0, 2]), snapshot(sound, [0, 2]))
    poisoned.step(commands, 10)
    assert not poisoned.read().is_sound[1]  # until it is reset
    begin(poisoned, arm, ids=np.array([1]))
    begin(sound, arm, ids=np.array([1]))
    assert poisoned.read().is_sound.all()
    poisoned.step(commands, 10)
    sound.step(commands, 10)
    assert_same(snapshot(poisoned, [1]), snapshot(sound, [1]))


def test_the_engine_of_the_configuration_is_made(arm):
    stepper = make_stepper(arm, 2, SettleConfig(timestep=0.002))
    assert isinstance(stepper, MujocoStepper) and stepper.num_sims == 2 and stepper.timestep == 0.002
    assert stepper.model.opt.timestep == 0.002
