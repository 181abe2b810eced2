"""Numbers in another unit are refused where they enter, and the unit is named; what an arm can have is let through."""

import jax.numpy as jnp
import numpy as np
import pytest
from arms import SHIPPED, altered, arm_named, over_rows, random_bends

from qjrl.config import ConfigError
from qjrl.robot import cable_lengths, forward_kinematics, robot_from_mapping
from qjrl.robot.plausibility import check_cable_lengths, check_positions, straight_length
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
    assert straight_length(arm) == pytest.approx(home[2], rel=1e-12)
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
    weak = robot_from_mapping(altered("qj_22", strands__strength=60.0))
    physics = {
        "settled_share": 1.0, "slack_share": 0.0, "tension": [1.0, 15.0, 60.0], "largest_motor_force": 5.0,
        "largest_bend_deg": 30.0,
    }  # fmt: skip
    (line,) = warnings_about(weak, {"strand_common_part": [0.0, 0.0]}, physics)
    assert "reaches 60 N, its strength" in line
