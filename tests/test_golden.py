"""The physics of today settles yesterday's commands where they settled yesterday."""

from pathlib import Path

import numpy as np
import pytest

from qjrl import artifacts
from qjrl.config import build
from qjrl.robot import load_robot, robot_from_mapping, robot_hash
from qjrl.simulation import SettleConfig, settle

GOLDEN = Path(__file__).parent.parent / "data" / "golden"


@pytest.fixture(scope="module")
def config():
    return artifacts.load(GOLDEN / "provenance.json")["config"]


def test_the_golden_rows_are_whole_settled_and_of_the_shipped_arm(config):
    robot = robot_from_mapping(config["robot"])
    assert robot_hash(robot) == robot_hash(load_robot("qj_2222"))
    data = artifacts.load(GOLDEN, robot_hash(robot))
    assert {len(column) for column in data.values()} == {256}
    assert data["converged"].all()
    assert data["equality_error"].max() < 1e-4


def test_16_golden_rows_settle_where_they_settled(config):
    robot = robot_from_mapping(config["robot"])
    data = artifacts.load(GOLDEN, robot_hash(robot))
    rows = np.arange(0, 256, 16)
    result = settle(robot, data["cable_lengths"][rows], config=build(SettleConfig, config["simulation"], "simulation"))
    assert result.converged.all()
    assert 1e3 * np.linalg.norm(result.pose[:, :3] - data["pose"][rows, :3], axis=1).max() < 0.01
    np.testing.assert_allclose(result.strand_tension, data["strand_tension"][rows], atol=0.05)
