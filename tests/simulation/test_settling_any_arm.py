"""Settling suits arms of any size with the defaults; what does not rest is told apart, and the setting named helps."""

import dataclasses
import logging

import numpy as np
import pytest
from arms import altered, over_rows, random_bends
from random_arms import random_arm

from qjrl.robot import cable_lengths, robot_from_mapping
from qjrl.simulation import SettleConfig, relaxation, settle
from qjrl.simulation.sampling import sample_lengths
from qjrl.simulation.settle_problem import SettleStatus
from qjrl.simulation.settling import unsettled

FEW_ARMS, MANY_ARMS = [1, 9, 14, 38, 39, 46], 120


def small():
    """Three segments on a circle of 10 mm, all else as shipped: with ten times its damping it creeps for minutes."""
    mapping = altered("qj_22", joints_per_segment=[2, 4, 1], link_length=0.0062, strands__pretension=36.0)
    mapping["joint"] |= {
        "crossed_link_length": 0.0151,
        "pin_distance": 0.0,
        "plate_to_pin": 0.0,
        "bend_limit_deg": 48.0,
    }
    mapping["cables"] = {
        "hole_circle_diameter": 0.0103,
        "hole_angles_deg": [[247, 98], [31, 121], [187, 155]],
        "names": [[1, 2], [3, 4], [5, 6]],
    }
    return robot_from_mapping(mapping)


def snake():
    """Twelve segments of one joint, 1.2 m long, all else as shipped: with ten times its damping most rows swing on."""
    mapping = altered("qj_22", joints_per_segment=[1] * 12, link_length=0.072)
    mapping["joint"] |= {"crossed_link_length": 0.027, "pin_distance": 0.0, "plate_to_pin": 0.0, "bend_limit_deg": 20.0}
    mapping["mechanics"] |= {"joint_mass": 0.005, "link_mass": 0.057, "link_radius": 0.02}
    mapping["cables"] = {
        "hole_circle_diameter": 0.038,
        "hole_angles_deg": [[7.5 * k, 90 + 7.5 * k] for k in range(12)],
        "names": [[2 * k + 1, 2 * k + 2] for k in range(12)],
    }
    return robot_from_mapping(mapping)


def drawn(arm, count: int) -> np.ndarray:
    """Commands as the stage `sample` draws them."""
    return sample_lengths(arm, seed=0, start=0, count=count, home_share=0.25)


@pytest.mark.parametrize("arm", [small(), snake()], ids=["small", "snake"])
def test_arms_of_others_rest_where_their_own_damping_rests_them(arm):
    """The same place as with the arm's own inertia and a damping scale that suits it."""
    lengths = drawn(arm, 3)
    found = settle(arm, lengths)
    scale = 1.0 if arm.num_segments == 3 else 100.0
    expected = settle(arm, lengths, config=SettleConfig(damping_scale=scale, max_time=60.0, speed_tolerance=1e-5))
    assert found.converged.all() and expected.converged.all()
    assert 1e3 * np.linalg.norm((found.pose - expected.pose)[:, :3], axis=1).max() < 0.02


@pytest.mark.parametrize("seed", FEW_ARMS)
def test_random_arms_settle_with_the_defaults(seed):
    arm = random_arm(seed)
    result = settle(arm, drawn(arm, 4))
    assert result.converged.all(), (seed, result.status)
    assert result.equality_error.max() < 1e-4


@pytest.mark.slow
def test_99_of_100_rows_of_random_arms_settle_with_the_defaults():
    """Hole circles of 10 to 200 mm, 1 to 12 segments."""
    arms = [random_arm(seed) for seed in range(MANY_ARMS)]
    shares = [settle(arm, drawn(arm, 16)).converged.mean() for arm in arms]
    assert np.mean(shares) >= 0.99
    assert np.mean(np.array(shares) == 1.0) >= 0.95


@pytest.mark.parametrize("name", ["timestep", "phase of the stiffest mode", "window", "tolerance"])
def test_the_pose_does_not_depend_on_how_the_stand_in_is_set(name, monkeypatch):
    arms = [random_arm(seed) for seed in (6, 46)] + [robot_from_mapping(altered("qj_2222"))]
    references = [settle(arm, drawn(arm, 4)) for arm in arms]
    config = {
        "timestep": SettleConfig(timestep=0.002, max_time=24.0),
        "phase of the stiffest mode": SettleConfig(),
        "window": SettleConfig(hold_time=0.15),
        "tolerance": SettleConfig(speed_tolerance=1e-6),
    }[name]
    if name.startswith("phase"):
        monkeypatch.setattr(relaxation, "STIFFEST", 0.5)
    for arm, reference in zip(arms, references, strict=True):
        found = settle(arm, drawn(arm, 4), config=config)
        assert found.converged.all() and reference.converged.all()
        reach = arm.num_joints * (float(arm.link_length) + float(arm.crossed_link_length))
        off = np.linalg.norm((found.pose - reference.pose)[:, :3], axis=1).max()
        assert off < 4e-5 * reach  # 0.02 mm of the shipped arm


def messages(arm, lengths, config, caplog) -> tuple[np.ndarray, str]:
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        result = settle(arm, lengths, config=config)
    assert result.status is not None
    return result.status, caplog.text


@pytest.mark.parametrize(
    ("arm", "scale", "kind", "helpful"),
    [
        (small(), 30.0, SettleStatus.CREEPS, 1.0),
        (snake(), 1.0, SettleStatus.OSCILLATES, 100.0),
        (random_arm(10), 10.0, SettleStatus.DIVERGES, None),
    ],
    ids=["creeping", "oscillating", "diverging"],
)
def test_what_does_not_rest_is_told_apart_and_the_setting_named_helps(arm, scale, kind, helpful, caplog):
    lengths = drawn(arm, 2)
    config = SettleConfig(damping_scale=scale, max_time=4.0)
    status, text = messages(arm, lengths, config, caplog)
    failed = status != SettleStatus.RESTS
    assert failed.any() and (status[failed] == kind).all()
    assert f"{failed.sum()} of 2 rows do not rest" in text and "simulation.damping_scale=null" in text
    assert "diverge" in text if kind == SettleStatus.DIVERGES else ("smaller" if helpful == 1.0 else "larger") in text
    for better in {None, helpful}:
        helped = settle(arm, lengths, config=dataclasses.replace(config, damping_scale=better, max_time=24.0))
        assert helped.converged.all(), better


def test_without_time_the_message_names_it_and_it_helps(caplog):
    arm = robot_from_mapping(altered("qj_22"))
    lengths = over_rows(cable_lengths, arm, random_bends(arm, 3, seed=3))
    status, text = messages(arm, lengths, SettleConfig(max_time=0.1), caplog)
    assert (status != SettleStatus.RESTS).all()
    assert "3 of 3 rows do not rest" in text and "larger simulation.max_time" in text
    status, text = messages(arm, lengths, SettleConfig(), caplog)
    assert (status == SettleStatus.RESTS).all() and not text


def test_a_line_counts_every_kind():
    status = np.array([0, 1, 1, 2, 3, 0])
    line = unsettled(status, SettleConfig())
    assert line.startswith("4 of 6 rows do not rest: 2 creep (") and "1 oscillate (" in line
    assert line.endswith("1 diverge (smaller simulation.timestep)")
