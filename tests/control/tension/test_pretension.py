"""The search for the least pretension: its arithmetic on made-up tensions, its answer on the two-segment arm."""

import dataclasses

import numpy as np
import pytest
from arms import arm_named

from qjrl.control.tension import pretension as search
from qjrl.control.tension.poses import single_segment_poses, workspace_poses
from qjrl.control.tension.pretension import PretensionConfig, Survey, choose, needed_pretension, survey
from qjrl.control.tension_check import TensionCheck, check_tension
from qjrl.simulation import SettleConfig
from qjrl.simulation.settling import SettleResult

ARM = arm_named("qj_22")
POSES = workspace_poses(ARM, "even", 16, seed=0)
CONFIG = PretensionConfig(pretensions=(10.0, 20.0, 40.0), resolution=0.5)


def made_up(tension: np.ndarray, settled: bool = True) -> TensionCheck:
    """A check of poses whose strands all carry what is given (n,)."""
    nothing = np.zeros((len(tension), 1))
    strands = np.repeat(tension[:, None], ARM.num_strands, axis=1)
    rest = SettleResult(
        ARM, nothing, nothing, strands, nothing, tension, tension, tension, np.full(len(tension), settled)
    )
    return TensionCheck(ARM, rest, CONFIG.least_tension)


@pytest.fixture
def linear_physics(monkeypatch):
    """Every pose's strands carry the pretension less what the first cable says [N]; returns what was settled."""
    settled = []

    def check(robot, lengths, least_tension, simulation, advance=None):
        settled.append((float(robot.pretension), len(lengths)))
        tension = float(robot.pretension) - lengths[:, 0]
        return made_up(tension) if float(robot.pretension) < 100.0 else made_up(tension, settled=False)

    monkeypatch.setattr(search, "check_tension", check)
    return settled


def with_losses(*losses: float):
    """Poses that lose so much tension [N]."""
    lengths = np.zeros((len(losses), ARM.num_cables))
    lengths[:, 0] = losses
    return dataclasses.replace(POSES, cable_lengths=lengths)


def test_the_answer_is_the_least_multiple_that_keeps_the_worst_pose(linear_physics):
    poses = with_losses(3.0, 14.3, 9.0, 21.7)
    found = survey(ARM, CONFIG, SettleConfig(), poses)
    assert list(found.checks) == [10.0, 15.0, 20.0, 40.0]  # the arm's own 15 N among them
    choice = choose(ARM, CONFIG, SettleConfig(), found)
    assert choice.pretension == choice.at == 24.0  # 21.7 lost and 2 kept
    assert choice.too_little == 23.5
    assert choice.check.is_safe.all()
    halving = linear_physics[4:-1]
    assert halving[0] == (30.0, 1)  # at 20 N one pose of four is left to look at
    assert linear_physics[-1] == (24.0, 4) and choice.num_settled == sum(count for _, count in linear_physics[4:])


def test_a_share_of_the_poses_may_be_given_up(linear_physics):
    config = dataclasses.replace(CONFIG, share=0.75)
    found = survey(ARM, config, SettleConfig(), with_losses(3.0, 14.3, 9.0, 21.7))
    choice = choose(ARM, config, SettleConfig(), found)
    assert choice.pretension == 16.5 and choice.check.is_safe.tolist() == [True, True, True, False]


def test_none_is_said_where_nothing_on_the_curve_is_enough(linear_physics):
    found = survey(ARM, CONFIG, SettleConfig(), with_losses(3.0, 50.0))
    choice = choose(ARM, CONFIG, SettleConfig(), found)
    assert choice.pretension is None and choice.at == 10.0 and choice.num_settled == 0
    unstable = dataclasses.replace(CONFIG, pretensions=(1.0, 200.0))
    assert (
        choose(ARM, unstable, SettleConfig(), survey(ARM, unstable, SettleConfig(), with_losses(20.0))).pretension
        is None
    )


def test_needed_pretension_is_interpolated():
    tension = {10.0: [1.0, 0.0, 5.0], 20.0: [9.0, 0.0, 15.0], 40.0: [29.0, 1.0, 35.0]}
    found = Survey(with_losses(0.0, 0.0, 0.0), {key: made_up(np.array(row)) for key, row in tension.items()})
    np.testing.assert_allclose(needed_pretension(CONFIG, found), [11.25, np.nan, 10.0])
    assert found.num_falling == 0


def test_the_physics_is_kept_at_the_answer_and_not_just_below():
    config = PretensionConfig(pretensions=(5.0, 40.0), resolution=1.0)
    found = survey(ARM, config, SettleConfig(), POSES)
    choice = choose(ARM, config, SettleConfig(), found)
    assert choice.pretension is not None and choice.check.is_safe.all()
    assert choice.pretension - choice.too_little <= 1.5
    below = search.at_pretension(ARM, choice.too_little)
    assert not check_tension(below, POSES.cable_lengths, config.least_tension).is_safe.all()
    assert np.nanmax(needed_pretension(config, found)) == pytest.approx(choice.pretension, abs=4.0)


def test_poses_are_nested_and_within_the_limit():
    largest = np.sin(float(ARM.bend_limit) / 2.0) + 1e-12
    for law in ("even", "uniform"):
        poses = workspace_poses(ARM, law, 32, seed=1)
        np.testing.assert_array_equal(poses.bends[:16], workspace_poses(ARM, law, 16, seed=1).bends)
        assert np.linalg.norm(poses.bends, axis=2).max() <= largest
    rim = workspace_poses(ARM, "even", 32, seed=1, rim_share=0.25).bends
    at_limit = np.isclose(np.linalg.norm(rim, axis=2), largest).all(axis=1)
    assert 5 <= at_limit.sum() <= 11
    np.testing.assert_array_equal(rim[~at_limit], workspace_poses(ARM, "even", 32, seed=1).bends[~at_limit])
    single = single_segment_poses(ARM, 3, 4).bends
    assert single.shape == (2 * 3 * 4, 2, 2)
    radius = np.linalg.norm(single.reshape(2, 3, 4, 2, 2), axis=-1)
    assert np.all(radius[0, :, :, 1] == 0.0) and np.all(radius[1, :, :, 0] == 0.0)
    np.testing.assert_allclose(radius[0, 2, :, 0], largest)
