import dataclasses

import numpy as np
import pytest
import yaml
from arms import MADE_UP, SHIPPED, altered, arm_named

from qjrl.config import ConfigError, conf_folder, read_yaml
from qjrl.robot import build_mjcf, load_robot, robot_from_mapping, robot_hash
from qjrl.robot.quaternion_arm.arm import require_arm
from qjrl.robot.quaternion_arm.mjcf_ties import fit_height_polynomial


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_file_loads_under_its_own_name(name):
    arm = arm_named(name)
    assert arm.name == name
    assert arm.joint_model == ("spherical" if "spherical" in name else "rolling")
    assert arm.num_cables == 2 * arm.num_segments == arm.num_strands // 2


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_value_states_its_source(name):
    """Each line that holds a value says where it comes from: the paper, the rule "ours", or a unit that is given there."""
    for line in (conf_folder() / "robot" / f"{name}.yaml").read_text().splitlines():
        key, _, rest = line.partition(":")
        is_value = rest.strip() and not line.startswith("#")
        if is_value and key.strip() not in ("kind", "schema", "name"):
            assert "ours" in rest or "paper" in rest, line


def test_the_shipped_arms_are_the_paper_s():
    assert load_robot("qj_2222").joints_per_segment == (2, 2, 2, 2)
    assert load_robot("qj_22").joints_per_segment == (2, 2)
    assert load_robot("qj_huang_4332").joints_per_segment == (4, 3, 3, 2)
    assert load_robot("qj_huang_4332_480").joints_per_segment == (4, 3, 3, 2)
    holes = load_robot("qj_2222").config.cables
    assert holes.hole_angles_deg == ((0, 90), (45, 135), (22.5, 112.5), (67.5, 157.5))
    assert holes.names == ((1, 5), (3, 7), (2, 6), (4, 8))


def test_an_arm_loads_from_a_file(tmp_path):
    path = tmp_path / "my_arm.yaml"
    path.write_text(yaml.safe_dump(altered("qj_22", name="my_arm")))
    assert load_robot(path).name == "my_arm"
    assert load_robot(str(path)).num_segments == 2


def test_equal_descriptions_have_equal_hashes_and_others_do_not():
    arm = load_robot("qj_22")
    assert robot_hash(arm) == robot_hash(robot_from_mapping(altered("qj_22")))
    hashes = {robot_hash(arm_named(name)) for name in [*SHIPPED, *MADE_UP]}
    assert len(hashes) == len(SHIPPED) + len(MADE_UP)
    assert robot_hash(robot_from_mapping(altered("qj_22", strands__pretension=14.0))) not in hashes


@pytest.mark.parametrize(
    ("changes", "key", "got", "allowed"),
    [
        ({"colour": "red"}, "robot.colour", "'red'", "known:"),
        ({"joint__pin_distanc": 0.01}, "robot.joint.pin_distanc", "0.01", "did you mean 'pin_distance'?"),
        ({"joint__crossed_link_length": -0.02}, "robot.joint.crossed_link_length", "-0.02", "above 0"),
        ({"link_length": -0.01}, "robot.link_length", "-0.01", "at least 0"),
        ({"link_length": "30 mm"}, "robot.link_length", "'30 mm'", "a finite number at least 0"),
        ({"joints_per_segment": []}, "joints_per_segment", "[]", "at least one segment"),
        ({"joints_per_segment": [2, 0]}, "robot.joints_per_segment[1]", "0", "from 1 to 6"),
        ({"joints_per_segment": [2, 2.5]}, "robot.joints_per_segment[1]", "2.5", "an integer"),
        ({"joints_per_segment": [2, 2, 2]}, "cables.hole_angles_deg", "2 pairs", "one for each of the 3 segments"),
        ({"joint__bend_limit_deg": 90.0}, "robot.joint.bend_limit_deg", "90.0", "above 0 and below 90"),
        ({"joint__bend_limit_deg": 89.0}, "joint.stop_margin_deg", "2.0", "below 90"),
        ({"joint__pin_distance": 0.03}, "joint.pin_distance", "0.03", "less than crossed_link_length = 0.02507"),
        ({"cables__hole_circle_diameter": 0.06}, "cables.hole_circle_diameter", "0.06", "less than 0.05071"),
        (
            {"cables__hole_angles_deg": [[0, 90], [45, 90.5]]},
            "cables.hole_angles_deg",
            "90.5",
            "all different by 1 deg",
        ),
        ({"cables__hole_angles_deg": [[0, 90], [180, 135]]}, "cables.hole_angles_deg", "180", "modulo 180"),
        ({"cables__hole_angles_deg": [[0, 90], [45]]}, "robot.cables.hole_angles_deg[1]", "[45]", "a list of 2"),
        ({"cables__names": [[1, 5], [3, 5]]}, "cables.names", "5, 3, 5", "all different"),
        ({"mechanics__gravity": [0, 0]}, "robot.mechanics.gravity", "[0, 0]", "a list of 3"),
        ({"strands__stiffness": 0}, "robot.strands.stiffness", "0", "above 0"),
        ({"strands__tensioner_stiffness": -5.0}, "robot.strands.tensioner_stiffness", "-5.0", "or null"),
        ({"motors": None}, "robot.motors", "null", "a mapping with the keys speed, force"),
        ({"kind": "octopus"}, "robot.kind", "'octopus'", "quaternion_arm"),
        ({"kind": ["a"]}, "robot.kind", "['a']", "quaternion_arm"),
        ({"schema": 2}, "robot.schema", "2", "one of 1"),
    ],
)
def test_an_impossible_value_is_one_line_with_key_value_and_what_is_allowed(changes, key, got, allowed):
    with pytest.raises(ConfigError) as error:
        robot_from_mapping(altered("qj_22", **changes))
    message = str(error.value)
    assert message.partition(": ")[0].endswith(key)
    assert message.startswith("robot.")
    assert got in message.partition(": ")[2]
    assert allowed in message
    assert "\n" not in message


def test_a_missing_value_is_named():
    mapping = altered("qj_22")
    del mapping["strands"]["pretension"], mapping["kind"]
    with pytest.raises(ConfigError, match=r"robot\.kind: missing, allowed: quaternion_arm"):
        robot_from_mapping(mapping)
    mapping["kind"] = "quaternion_arm"
    with pytest.raises(ConfigError, match=r"robot\.strands\.pretension: missing, allowed: a finite number at least 0"):
        robot_from_mapping(mapping)


def test_an_unknown_name_says_which_arms_there_are(tmp_path):
    with pytest.raises(ConfigError, match=r"robot: got 'qj_222', .*did you mean 'qj_22"):
        load_robot("qj_222")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_robot(tmp_path / "none.yaml")


def test_pins_almost_as_far_apart_as_the_links_are_long_are_refused_by_the_physics():
    arm = robot_from_mapping(altered("qj_22", joint__crossed_link_length=0.036, joint__pin_distance=0.0345))
    with pytest.raises(ConfigError, match=r"robot\.joint\.pin_distance: got 0\.0345, allowed: up to about"):
        build_mjcf(arm)


def test_a_robot_is_a_frozen_tree_of_numbers():
    arm = load_robot("qj_22")
    with pytest.raises(dataclasses.FrozenInstanceError):
        arm.pretension = 3.0  # pyright: ignore[reportAttributeAccessIssue]
    assert read_yaml(conf_folder() / "robot" / "qj_22.yaml")["strands"]["pretension"] == float(arm.pretension)


def scaled(name: str, factor: float, **changes):
    """A shipped arm with all its lengths times a factor, its masses times the third power of it."""
    mapping = altered(name, **changes)
    for part, keys in {
        "joint": ("crossed_link_length", "pin_distance", "plate_to_pin"),
        "cables": ("hole_circle_diameter",),
        "mechanics": ("link_radius",),
    }.items():
        for key in keys:
            mapping[part][key] *= factor
    mapping["link_length"] *= factor
    for key in ("joint_mass", "link_mass"):
        mapping["mechanics"][key] *= factor**3
    return robot_from_mapping(mapping)


@pytest.mark.parametrize("name", SHIPPED)
def test_an_arm_in_another_size_is_as_allowed_and_its_heights_as_well_fitted(name):
    """The quartic of the slide by the length measured is the same in the arm's own unit."""
    factors = np.geomspace(0.1, 10.0, 7).tolist()
    if arm_named(name).joint_model == "spherical":
        for factor in factors:
            assert build_mjcf(scaled(name, factor))
        return
    reference = fit_height_polynomial(arm_named(name))
    for factor in factors:
        arm = scaled(name, factor)
        assert build_mjcf(arm)
        in_own_unit = fit_height_polynomial(require_arm(arm, "this test")) * factor ** (np.arange(5) - 1.0)
        np.testing.assert_allclose(in_own_unit, reference, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_pins_too_far_apart_are_refused_in_every_size_and_what_is_named_is_allowed(factor):
    with pytest.raises(ConfigError, match="allowed: up to about") as refused:
        build_mjcf(scaled("qj_22", factor, joint__crossed_link_length=0.036, joint__pin_distance=0.0345))
    named = float(str(refused.value).split("up to about ")[1].split()[0])
    pins = 0.995 * named / factor
    assert build_mjcf(scaled("qj_22", factor, joint__crossed_link_length=0.036, joint__pin_distance=pins))


def test_names_and_homes_of_robots(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "MY.YAML").write_text(yaml.safe_dump(altered("qj_22", name="my")))
    assert load_robot("~/MY.YAML").name == "my"
    for name in ("", " ", "a\nb", "a" * 5000):
        with pytest.raises(ConfigError, match=r"^robot\.name: got .*allowed: a text on one line") as error:
            robot_from_mapping(altered("qj_22", name=name))
        assert len(str(error.value)) < 200 and "\n" not in str(error.value)
    with pytest.raises(ConfigError, match="known: continuum_4, qj_22, qj_2222,"):
        load_robot(tmp_path)


def test_numbers_of_numpy_describe_the_same_arm():
    given = robot_from_mapping(altered("qj_22", link_length=np.float64(0.03), joints_per_segment=np.array([2, 2])))
    assert robot_hash(given) == robot_hash(load_robot("qj_22"))
