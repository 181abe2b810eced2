import copy
import dataclasses
import math
from functools import partial, reduce

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import ARMS, altered, arm_named, arm_of, made_up_mapping, random_bends

from qjrl.config import ConfigError, as_mapping, build
from qjrl.robot import build_mjcf, cable_lengths, forward_kinematics, load_robot, robot_hash, strand_lengths
from qjrl.robot.quaternion_arm.arm import _PLACES
from qjrl.robot.quaternion_arm.description import QuaternionArmConfig
from qjrl.robot.quaternion_arm.dynamics import Load, equations_of_motion
from qjrl.robot.quaternion_arm.kind import QUATERNION_ARM
from qjrl.simulation import settle

ARM = arm_named("rolling_312")
BENDS = jnp.asarray(random_bends(ARM, 1, share=0.6)[0])
NUMBERS = [leaf for leaf in _PLACES if leaf not in ("gravity", "hole_angles_deg")]


def changed(leaf: str, factor: float) -> tuple:
    """The arm with one leaf changed, and the arm of a description with that value."""
    mapping = copy.deepcopy(made_up_mapping("rolling_312"))
    *section, key = _PLACES[leaf].split(".")
    inner = reduce(dict.__getitem__, section, mapping)
    inner[key] *= factor
    if inner[key] == 0.0:  # the arm has none of it
        inner[key] = 0.01
    return dataclasses.replace(ARM, **{leaf: inner[key]}), arm_of(mapping)


@pytest.mark.parametrize("leaf", NUMBERS)
def test_a_changed_leaf_changes_everything_as_its_description_would(leaf):
    arm, described = changed(leaf, 0.97)
    assert as_mapping(arm.config) == as_mapping(described.config)
    assert robot_hash(arm) == robot_hash(described) != robot_hash(ARM)
    assert build_mjcf(arm) == build_mjcf(described)
    assert (build_mjcf(arm) == build_mjcf(ARM)) == (
        leaf in ("pretension", "motor_speed", "motor_force", "pulley_radius")
    )
    for function in (forward_kinematics, cable_lengths, strand_lengths):
        np.testing.assert_array_equal(function(arm, BENDS), function(described, BENDS))
    for limits, expected in zip(
        *(jax.tree.leaves(QUATERNION_ARM.limits(one)) for one in (arm, described)), strict=True
    ):
        np.testing.assert_array_equal(limits, expected)


def test_every_number_of_the_description_is_a_leaf():
    numbers = jax.tree.leaves(as_mapping(ARM.config) | {"schema": "", "joints_per_segment": "", "kind": ""})
    count = sum(isinstance(number, float) for number in numbers)
    assert count == sum(np.size(leaf) for leaf in jax.tree.leaves(ARM))


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("is_double", [True, False])
def test_the_description_comes_back_whole_in_any_precision(name, is_double):
    with jax.enable_x64(is_double):
        arm = arm_named(name)
        mapping = as_mapping(arm.config)
        assert as_mapping(build(QuaternionArmConfig, mapping)) == mapping
        through = jax.jit(lambda arm: arm)(arm)
        assert as_mapping(through.config) == mapping  # no shipped number has more digits than float32 holds
        assert robot_hash(load_robot(name)) == robot_hash(through) if not name.endswith("_312") else True


def test_a_number_of_many_digits_is_the_same_robot_without_double_precision():
    mapping = altered("qj_22", link_length=0.0301234567890123)
    with jax.enable_x64(False):
        single = robot_hash(arm_of(mapping))
    assert single == robot_hash(arm_of(mapping))


def test_settling_a_longer_arm_is_settling_its_description():
    lengths = np.array([[0.004, -0.003, 0.002, 0.001]])
    longer = dataclasses.replace(arm_named("qj_22"), link_length=0.036)
    found, expected = settle(longer, lengths), settle(arm_of(altered("qj_22", link_length=0.036)), lengths)
    np.testing.assert_array_equal(found.pose, expected.pose)
    assert np.linalg.norm(found.pose[0, :3] - settle(arm_named("qj_22"), lengths).pose[0, :3]) > 0.01


def rest_position(arm, lengths):
    rest = QUATERNION_ARM.equilibrium
    assert rest is not None
    return forward_kinematics(arm, rest(arm, lengths).configuration)[:3]


def test_gradients_of_a_rest_pose_are_its_finite_differences_and_how_the_settled_pose_of_mujoco_moves():
    leaves = ["link_length", "crossed_link_length", "link_mass", "joint_stiffness", "payload"]
    arm = dataclasses.replace(arm_named("qj_22"), payload=0.05)
    values, lengths = jnp.array([getattr(arm, leaf) for leaf in leaves]), jnp.array([0.006, -0.004, 0.003, 0.002])

    @jax.jit
    def position_and_slopes(row):
        position = lambda row: rest_position(dataclasses.replace(arm, **dict(zip(leaves, row, strict=True))), lengths)  # noqa: E731
        return position(row), jax.jacfwd(position)(row)

    numeric = np.zeros((3, len(leaves)))
    for place, step in enumerate(1e-4 * np.asarray(values)):
        ends = [position_and_slopes(values.at[place].add(sign * step))[0] for sign in (-1.0, 1.0)]
        numeric[:, place] = (ends[1] - ends[0]) / (2.0 * step)
    scale, slopes = np.linalg.norm(numeric, axis=0), position_and_slopes(values)[1]
    assert np.all(scale > 1e-6)
    np.testing.assert_allclose(slopes / scale, numeric / scale, atol=1e-4)

    longer = [dataclasses.replace(arm, link_length=0.03 + change) for change in (-0.002, 0.002)]
    settled = [settle(one, np.asarray(lengths)[None]).pose[0, :3] for one in longer]
    np.testing.assert_allclose((settled[1] - settled[0]) / 0.004, slopes[:, 0], atol=5e-3)


def test_a_batch_of_arms_is_its_arms_one_by_one():
    lengths = jnp.linspace(0.01, 0.04, 8)
    arms = [dataclasses.replace(ARM, link_length=float(length)) for length in lengths]
    axes = jax.tree.map(lambda leaf: None, ARM).replace(link_length=0)  # pyright: ignore[reportAttributeAccessIssue]
    batch, held = dataclasses.replace(ARM, link_length=lengths), cable_lengths(ARM, 0.5 * BENDS)
    zeros, load = jnp.zeros_like(BENDS), Load(jnp.asarray(ARM.gravity), jnp.ones(()), jnp.zeros(()))

    def over(function):
        single = jax.jit(function)
        return jax.jit(jax.vmap(function, in_axes=(axes,)))(batch), [single(arm) for arm in arms]

    mass = lambda arm: equations_of_motion(arm, load, 0.2 * BENDS, zeros).mass  # noqa: E731
    tip = lambda arm: QUATERNION_ARM.tip_of(arm, BENDS.reshape(-1)).velocity  # noqa: E731
    functions = (partial(forward_kinematics, configuration=BENDS), partial(rest_position, lengths=held), mass, tip)
    for function in functions:
        together, apart = over(function)
        np.testing.assert_allclose(together, jnp.stack(apart), rtol=1e-9, atol=1e-12)
        assert len(np.unique(np.round(np.asarray(together), 9), axis=0)) == 8


def test_a_batch_of_arms_has_no_description():
    with pytest.raises(ConfigError, match=r"robot\.link_length: got an array of shape \(8,\), allowed: 0 axes"):
        build_mjcf(dataclasses.replace(ARM, link_length=jnp.ones(8)))


def test_a_traced_arm_has_no_description():
    with pytest.raises(ConfigError, match=r"robot\.crossed_link_length: got a value that JAX traces"):
        jax.jit(lambda arm: arm.config.link_length)(ARM)


def test_a_joint_changes_its_model_with_its_pins_or_is_refused():
    spherical = arm_named("qj_2222_spherical")
    with pytest.raises(ConfigError, match="in a spherical joint, allowed: both 0"):
        robot_hash(dataclasses.replace(spherical, pin_distance=0.01))
    assert math.isclose(
        dataclasses.replace(spherical, pin_distance=0.01, joint_model="rolling").config.joint.pin_distance, 0.01
    )


def test_an_impossible_number_is_refused_where_the_arm_is_described():
    with pytest.raises(ConfigError, match=r"robot\.mechanics\.link_mass: got -0.1, allowed"):
        build_mjcf(dataclasses.replace(ARM, link_mass=-0.1))
