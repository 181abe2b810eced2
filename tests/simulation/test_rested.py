"""Where nothing rests, or no episode is sound, every study says so in one line that names the stage."""

import dataclasses

import numpy as np
import pytest
from arms import arm_named

from qjrl.config import ConfigError
from qjrl.control import inversion
from qjrl.control.tension import pretension
from qjrl.control.tension.poses import workspace_poses
from qjrl.simulation import SettleConfig
from qjrl.simulation.rested import require_rest, require_valid
from qjrl.simulation.settling import SettleResult
from qjrl.solvers import LeastSquaresConfig
from qjrl.studies.accuracy import feasibility, feedback, held_out
from qjrl.studies.open_loop import measure as open_loop

ARM = arm_named("qj_22")
HOME = np.tile([0.0, 0.0, 0.24, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], (4, 1))
CALM = SettleConfig()


def restless(robot, lengths, *_, **__):
    """What `settle` gives of an arm that never rests."""
    count = len(lengths)
    nothing = np.full(count, np.nan)
    shapes = {"pose": (9,), "configuration": (2, 2), "strand_tension": (8,), "joint_positions": (20,)}
    arrays = {name: np.full((count, *shape), np.nan) for name, shape in shapes.items()}
    return SettleResult(
        robot, **arrays, equality_error=nothing, speed=nothing, steps=nothing, converged=np.zeros(count, bool)
    )


@dataclasses.dataclass
class Answers:
    cable_lengths: np.ndarray


def one_line(call, stage):
    with pytest.raises(ConfigError, match=rf"^{stage}: .*stages=\[describe\]") as error:
        call()
    assert "\n" not in str(error.value)


def test_every_study_that_settles_says_that_nothing_rests(monkeypatch):
    for module in (inversion, feasibility, feedback, open_loop):
        monkeypatch.setattr(module, "settle", restless)
    monkeypatch.setattr(held_out, "sample_rows", lambda *_, **__: {"converged": np.zeros(9, bool)})
    monkeypatch.setattr("qjrl.control.tension_check.settle", restless)
    answers = Answers(np.zeros((4, 4)))
    monkeypatch.setattr(open_loop, "first_commands", lambda *_: {"fabrik": answers})
    monkeypatch.setattr(feasibility, "solve_model", lambda *_: answers)
    monkeypatch.setattr(feasibility, "_columns", lambda *_: {})
    bank = {"nominal_lengths": np.zeros((4, 4)), "target": HOME, "target_set": np.array([0, 0, 1, 1])}
    one_line(lambda: inversion.settle_answers(ARM, CALM, bank), "ik")
    config = open_loop.OpenLoopConfig(num_targets=4)
    ik = inversion.IKConfig()
    one_line(lambda: open_loop.run_open_loop(ARM, None, CALM, ik, config, "uniform", 0), "open_loop")  # pyright: ignore[reportArgumentType]
    one_line(lambda: feasibility.evaluate_tension(ARM, None, CALM, ik, HOME, 0), "accuracy")  # pyright: ignore[reportArgumentType]
    noise = feedback.MeasurementNoise()
    solver = LeastSquaresConfig()
    one_line(
        lambda: feedback.measure_and_correct(ARM, None, CALM, solver, HOME, np.zeros((4, 4)), 1, noise, 0), "accuracy"
    )
    one_line(lambda: held_out.reachable_targets(ARM, CALM, HOME, 4, 0.005, 0), "accuracy")
    poses = workspace_poses(ARM, "even", 8, 0)
    one_line(lambda: pretension.survey(ARM, pretension.PretensionConfig(), CALM, poses), "pretension")


def test_one_that_rests_is_enough():
    for count in range(1, 50):
        is_sound = np.zeros(count, bool)
        one_line(lambda rows=is_sound: require_rest(rows, "ik"), "ik")
        one_line(lambda rows=is_sound: require_valid(rows, "compare"), "compare")
        is_sound[count // 2] = True
        require_rest(is_sound, "ik")
        require_valid(is_sound, "compare")
    one_line(lambda: require_rest(np.zeros(0, bool), "ik"), "ik")
