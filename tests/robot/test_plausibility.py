"""Numbers in another unit are refused where they enter, and the unit is named; what an arm can have is let through."""

import dataclasses
import inspect
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import SHIPPED, altered, arm_named, arm_of, over_rows, random_bends

from qjrl.config import ConfigError
from qjrl.robot import (
    bends_from_angles,
    bends_from_cables,
    cable_lengths,
    configuration_from_joint_positions,
    equilibrium,
    forward_kinematics,
    joint_positions,
    robot_from_mapping,
    strand_commands,
    strand_lengths,
    strand_tension,
)
from qjrl.robot.kinds import require_robot
from qjrl.robot.kinds import verb as verb_of
from qjrl.robot.plausibility import check_cable_lengths, check_positions, one_sample
from qjrl.robot.verbs import is_at_strength
from qjrl.simulation import settle
from qjrl.simulation.survey import warnings_about
from qjrl.solvers import solve_least_squares

ARM = arm_named("qj_22")


@pytest.mark.parametrize("name", SHIPPED)
def test_whatever_an_arm_does_is_plausible_and_in_millimetres_it_is_not(name):
    arm = arm_named(name)
    bends = random_bends(arm, 50)
    lengths, poses = over_rows(cable_lengths, arm, bends), over_rows(forward_kinematics, arm, bends)
    check_cable_lengths(arm, lengths, strokes=1.0 + 1e-9)
    check_positions(arm, poses[:, :3], "here")
    home = np.asarray(forward_kinematics(arm, jnp.zeros((arm.num_segments, 2))))
    assert verb_of(arm, "reach")(arm) == pytest.approx(home[2], rel=1e-12)
    for factor in (1000.0, 100.0):
        with pytest.raises(ConfigError, match="in millimetres"):
            check_positions(arm, factor * poses[:, :3], "here")
    with pytest.raises(ConfigError, match=r"cable_\d.*in millimetres"):
        check_cable_lengths(arm, 1000.0 * lengths)


def test_settling_and_solving_refuse_millimetres_and_answer_what_is_a_little_too_far():
    with pytest.raises(ConfigError, match=r"row 1 .*cable_3: got 5 m.*in millimetres"):
        settle(ARM, np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 5.0, 0.0]]))
    home = np.asarray(forward_kinematics(ARM, jnp.zeros((2, 2))))[None]
    far, absurd = home.copy(), home.copy()
    far[0, 2], absurd[0, 2] = 0.5, 240.0
    assert np.asarray(solve_least_squares(ARM, far).cable_lengths).shape == (1, 4)
    with pytest.raises(ConfigError, match=r"targets: row 0 .*240 m from the base.*in millimetres"):
        solve_least_squares(ARM, absurd)


IN_MM = {
    "joint__crossed_link_length": 25.07, "joint__pin_distance": 14.0, "joint__plate_to_pin": 4.6, "link_length": 30.0,
    "cables__hole_circle_diameter": 31.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "key", "hint"),
    [
        (IN_MM, "link_length", "in millimetres"),
        (IN_MM | {"mechanics__link_radius": 18.0, "motors__pulley_radius": 20.0}, "link_length", "in millimetres"),
        *[
            ({key: value}, key.replace("__", "."), "in millimetres")
            for key, value in IN_MM.items()
            if "crossed" not in key
        ],
        ({"mechanics__link_radius": 18.0}, "mechanics.link_radius", "in millimetres"),
        ({"motors__pulley_radius": 20.0}, "motors.pulley_radius", "in millimetres"),
        ({"motors__speed": 31.4}, "motors.speed", "in millimetres"),
        ({"mechanics__gravity": [0, 0, -9810.0]}, "mechanics.gravity", "in millimetres"),
        ({"mechanics__link_mass": 25.0}, "mechanics.link_mass", "in grams"),
        ({"joint__bend_limit_deg": 1.2217}, "joint.bend_limit_deg", "in radians"),
        ({"cables__hole_angles_deg": [[0, 1.5708], [0.7854, 2.3562]]}, "cables.hole_angles_deg", "in radians"),
        ({"strands__stiffness": 20.0}, "strands.stiffness", "in N/mm"),
        ({"strands__strength": 15.0}, "strands.pretension", "breaks"),
    ],
)
def test_descriptions_in_another_unit_are_refused_with_the_unit(changes, key, hint):
    with pytest.raises(ConfigError, match=key.replace(".", r"\.")) as error:
        robot_from_mapping(altered("qj_22", **changes))
    assert hint in str(error.value) and "\n" not in str(error.value)


def test_arms_of_every_size_are_allowed():
    random = np.random.default_rng(0)
    lengths = [*IN_MM, "mechanics__link_radius", "motors__pulley_radius"]
    for size in (10.0 ** random.uniform(-0.7, 1.2, 50)).tolist():  # 6 mm to half a metre of hole circle
        plain = altered("qj_22")
        scaled = {}
        for key in lengths:
            part, _, field = key.partition("__")
            scaled[key] = size * (plain[part][field] if field else plain[part])
        robot_from_mapping(altered("qj_22", **scaled))


def test_the_holes_that_collide_are_named():
    with pytest.raises(ConfigError, match=r"the holes of cable \d at (180|0) and of cable \d at (0|180) collide$"):
        robot_from_mapping(altered("qj_22", cables__hole_angles_deg=[[0, 90], [180, 135]]))
    with pytest.raises(ConfigError, match=r"cable 5 at 90 and of cable 7 at 90.5 collide$"):
        robot_from_mapping(altered("qj_22", cables__hole_angles_deg=[[0, 90], [45, 90.5]]))


def test_a_strand_at_its_strength_counts_as_broken_in_double_and_single_precision():
    for strength in (60.0, 61.3, 0.1, 599.99):
        arm = robot_from_mapping(altered("qj_22", strands__strength=strength, strands__pretension=0.05))
        assert is_at_strength(arm, strength) and is_at_strength(arm, np.float64(np.float32(strength)))
        assert not is_at_strength(arm, 0.999 * strength)
    weak = arm_of(altered("qj_22", strands__strength=60.0))
    physics = {
        "settled_share": 1.0, "slack_share": 0.0, "tension": [1.0, 15.0, 60.0], "largest_motor_force": 5.0,
        "largest_bend_deg": 30.0,
    }  # fmt: skip
    (line,) = warnings_about(weak, {"strand_common_part": [0.0, 0.0]}, physics)
    assert "reaches 60 N, its strength" in line


@pytest.mark.parametrize("shape", [(1, 2), (3, 2), (4, 2), (2,), (2, 3), (5, 2, 2)])
def test_bends_of_another_arm_are_refused_by_every_verb(shape):
    """Indexing in JAX would take some of them, or the last one twice, and answer."""
    for verb in (forward_kinematics, cable_lengths, strand_lengths, joint_positions):
        with pytest.raises(ValueError, match=r"configuration: got the shape .*, allowed: \(2, 2\)"):
            verb(ARM, jnp.zeros(shape))


@pytest.mark.parametrize("shape", [(3,), (8,), (2, 4), (1, 4)])
def test_lengths_of_another_arm_are_refused_by_every_verb(shape):
    for verb in (bends_from_cables, strand_commands, equilibrium, strand_tension):
        with pytest.raises(ValueError, match=r"lengths: got the shape .*, allowed: \(4,\)"):
            verb(ARM, jnp.zeros(shape))


BEND_VERBS = (forward_kinematics, cable_lengths, strand_lengths, joint_positions)
LENGTH_VERBS = (bends_from_cables, strand_commands, equilibrium, strand_tension)


def refused(words: str, verb, *arguments) -> None:
    with pytest.raises(ConfigError) as error:
        verb(*arguments)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("bends", "words"),
    [
        ([[0.2, 0.1], [0.8, 0.7]], "segment 1 (the first is 0): got a bend of length 1.063, allowed: below 1"),
        ([[0.0, 1.2], [0.1, 0.0]], "angles in radians? bends_from_angles"),
        ([[20.0, 0.0], [0.1, 0.0]], "angles in degrees? bends_from_angles"),
        ([[np.nan, 0.0], [0.1, 0.0]], "got nan at [0, 0], allowed: finite numbers"),
    ],
)
def test_bends_that_no_joint_has_are_refused_by_every_verb(bends, words):
    for verb in BEND_VERBS:
        refused(words, verb, ARM, np.array(bends))


def test_lengths_in_millimetres_are_refused_by_every_verb():
    lengths = 1000.0 * np.asarray(cable_lengths(ARM, jnp.array([[0.2, 0.1], [0.0, -0.3]])))
    for verb in LENGTH_VERBS:
        refused("in millimetres? divide by 1,000", verb, ARM, lengths)
        refused("finite numbers", verb, ARM, np.full(4, np.inf))


NO_REAL_NUMBERS = (
    (lambda values: np.ma.masked_array(values, mask=np.zeros_like(values)), "masked array"),
    (lambda values: values + 0.1j, "complex128 values"),
    (lambda values: values.astype(str), "allowed: real numbers"),
    (lambda values: values.astype(object), "object values"),
    (lambda values: values.astype(bool), "bool values"),
)


@pytest.mark.parametrize(("change", "words"), NO_REAL_NUMBERS, ids=range(5))
def test_arrays_of_anything_but_real_numbers_are_refused_at_every_door(change, words):
    bends, lengths, targets = np.zeros((2, 2)), np.zeros(4), np.zeros((1, 9))
    for verb in BEND_VERBS:
        refused(words, verb, ARM, change(bends))
    for verb in LENGTH_VERBS:
        refused(words, verb, ARM, change(lengths))
    refused(words, settle, ARM, change(lengths[None]))
    refused(words, solve_least_squares, ARM, change(targets))
    refused(words, bends_from_angles, change(lengths), change(lengths))


def test_rows_of_unequal_length_are_one_line():
    refused("rows of unequal length", one_sample, [[0.0, 0.1], [0.0]], (2, 2), "here")


def test_joint_positions_have_the_shape_of_the_arm():
    for name in ("qj_22", "qj_2222_spherical"):
        arm = arm_named(name)
        bends = jnp.asarray(random_bends(arm, 1)[0])
        positions = joint_positions(arm, bends)
        assert positions.shape == (arm.num_positions,)
        np.testing.assert_allclose(configuration_from_joint_positions(arm, positions), bends, atol=1e-12)
        twice = jnp.concatenate([positions, positions])
        refused("positions: got the shape", configuration_from_joint_positions, arm, twice)


def test_angles_in_degrees_are_refused_and_every_bend_of_a_joint_is_let_through():
    refused("got 40 rad, allowed: up to pi, a bend of 180 degrees; in degrees?", bends_from_angles, 0.0, 40.0)
    assert np.isfinite(bends_from_angles(np.array([0.0, 1.0]), np.array([3.1, -0.5]))).all()


def test_whole_numbers_are_computed_with_as_real_ones():
    assert one_sample([0, 1], (2,), "here").dtype == one_sample([0.0, 1.0], (2,), "here").dtype
    np.testing.assert_array_equal(strand_commands(ARM, jnp.zeros(4, int)), strand_commands(ARM, jnp.zeros(4)))


def test_what_is_traced_is_not_looked_at_and_gives_what_it_gave():
    """Closed over or mapped, robot and values are unknown while JAX traces; a constant among them is known."""
    far = jnp.full((3, 2, 2), 20.0)
    assert jax.vmap(lambda bends: forward_kinematics(ARM, bends))(far).shape == (3, 9)
    lengths: Any = np.full(4, 0.01)
    inside = jax.jit(lambda: bends_from_cables(ARM, lengths))()
    np.testing.assert_allclose(inside, bends_from_cables(ARM, lengths), atol=1e-15)
    wider = lambda diameter: dataclasses.replace(ARM, hole_circle_diameter=diameter)  # noqa: E731
    assert np.isfinite(jax.jacfwd(lambda value: bends_from_cables(wider(value), lengths))(0.031)).all()


def test_random_bends_are_refused_exactly_from_180_degrees_on():
    random = np.random.default_rng(3)
    for _ in range(30):
        bends = random.normal(size=(2, 2)) * random.choice([0.3, 1.0])
        if np.linalg.norm(bends, axis=1).max() < 1.0:
            assert np.isfinite(forward_kinematics(ARM, bends)).all()
        else:
            refused("allowed: below 1", forward_kinematics, ARM, bends)


def test_what_is_no_robot_is_one_line():
    """Where no checker of types stands before the functions, as it does in these tests."""
    refused("robot: got 'qj_22', allowed: what load_robot returns", require_robot, "qj_22")
    refused("robot: got [1], allowed: a mapping", inspect.unwrap(robot_from_mapping), [1])
    assert one_sample(np.zeros(2, np.longdouble), (2,), "here").dtype == np.float64


@pytest.mark.parametrize("steps", [0, -1, True])  # of another type they are refused by the checker of these tests first
def test_steps_of_statics_are_counted(steps):
    refused("steps: got", strand_tension, ARM, np.zeros(4), steps)
