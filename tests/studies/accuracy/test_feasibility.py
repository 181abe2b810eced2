"""Targets out of reach on the paper's arm, and what is measured of their answers on a stand-in for a learned model."""

import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends

from qjrl.control.inversion import IKConfig
from qjrl.geometry.pose import row_errors
from qjrl.robot import forward_kinematics
from qjrl.robot.forward_model import pose_function
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.solvers import LeastSquaresConfig, Status
from qjrl.solvers.least_squares import RoundConfig
from qjrl.studies.accuracy.feasibility import (
    UnreachableConfig,
    evaluate_tension,
    evaluate_unreachable,
    unreachable_targets,
)

ARM = arm_named("qj_2222")
REACHABLE = over_rows(forward_kinematics, ARM, random_bends(ARM, 12, seed=1))
CONFIG = UnreachableConfig(num_targets=6, thorough=RoundConfig(16, 50))
IK = IKConfig(least_squares=LeastSquaresConfig(num_candidates=512, batch_size=16))
MODEL = pose_function(ARM, None)


def test_far_targets_lie_beyond_the_straight_arm_and_turned_ones_are_turned():
    targets = unreachable_targets(ARM, REACHABLE, CONFIG, seed=0)
    far, turned = targets[:6], targets[6:]
    length = float(forward_kinematics(ARM, jnp.zeros((4, 2)))[2])
    ratio = np.linalg.norm(far[:, :3], axis=1) / length
    assert np.all((ratio >= 1.05) & (ratio <= 1.3)) and np.ptp(ratio) > 0.05
    np.testing.assert_array_equal(far[:, 3:], REACHABLE[:6, 3:])
    distance, angle = row_errors(turned, REACHABLE[:6])
    assert (
        distance.max() == 0.0 and np.all((angle >= np.radians(120) - 1e-9) & (angle <= np.pi)) and np.ptp(angle) > 0.1
    )
    assert not np.array_equal(targets, unreachable_targets(ARM, REACHABLE, CONFIG, seed=1))


@pytest.mark.slow
def test_far_targets_are_flagged_and_settle_near_the_closed_form():
    targets = unreachable_targets(ARM, REACHABLE, CONFIG, seed=0)
    found = evaluate_unreachable(ARM, MODEL, SettleConfig(), IK, CONFIG, targets, seed=0)
    assert found["kind"].tolist() == [0] * 6 + [1] * 6
    assert np.all(found["answer/status"][:6] == Status.NEAREST)
    assert np.all(found["answer/position_error"][:6] > 0.01)
    weighted = {
        name: np.hypot(found[f"{name}/position_error"], 0.1 * found[f"{name}/orientation_error"])
        for name in ("answer", "best")
    }
    assert np.all(weighted["best"] <= weighted["answer"] + 1e-9)  # a thorough search has the same starts, and more
    rests = found["settled"]
    assert rests.mean() > 0.8 and 1e-4 < np.median(found["model_distance"][rests]) < 0.03


@pytest.mark.parametrize("name", ["any", "wanted"])
def test_predicted_tensions_are_those_of_the_physics(name):
    targets = over_rows(forward_kinematics, ARM, random_bends(ARM, 24, seed=1))
    found = evaluate_tension(ARM, MODEL, SettleConfig(), IK, targets, seed=0)
    np.testing.assert_allclose(found[f"{name}/least_tension"], found[f"{name}/settled_least_tension"], atol=0.02)
    loose = {key: np.sum(found[f"{key}/least_tension"] < 2.0) for key in ("any", "wanted")}
    assert loose["wanted"] < loose["any"]
