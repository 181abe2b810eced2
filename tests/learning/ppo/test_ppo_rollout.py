import numpy as np
import pytest

from qjrl.learning.ppo.environment import Transition
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.iteration import value_of_cut_off
from qjrl.learning.ppo.rollout import Action, collect, finite_rows


class Scripted:
    """Two copies; both observations hold [step, copy], the reward is the step; one array is reused for all steps."""

    num_envs, action_size = 2, 1

    def __init__(self, truncated=(), terminated=(), invalid=(), broken=()):
        self.observation_sizes = {"state": 2, "privileged_state": 2}
        self.gives_advice = False
        self.events = {"truncated": truncated, "terminated": terminated, "invalid": invalid, "broken": broken}
        self.steps = 0
        self.rows = np.array([[0, 0], [0, 1]], np.float32)

    def reset(self):
        return {"state": self.rows, "privileged_state": self.rows}

    def step(self, actions):
        assert actions.shape == (2, 1)
        reward = np.full(2, self.steps, np.float32)
        marks = {
            name: np.array([(self.steps, copy) in places for copy in (0, 1)]) for name, places in self.events.items()
        }
        self.steps += 1
        self.rows[:, 0] = self.steps
        final = self.rows + 100
        observation = np.where(marks["broken"][:, None], np.float32(np.nan), self.rows)
        both = {"state": observation, "privileged_state": observation}
        ends = {"state": final, "privileged_state": final}
        return Transition(both, reward, marks["terminated"], marks["truncated"], ends, ~marks["invalid"], {"m": reward})

    def get_state(self):
        return {}

    def set_state(self, state):
        assert not state


def act(observation, step):
    del step
    assert np.isfinite(observation).all()
    zeros = np.zeros((2, 1), np.float32)
    return Action(zeros, zeros, np.zeros((2, 2), np.float32), np.zeros(2, np.float32))


def collected(num_steps=4, **events):
    environment = Scripted(**events)
    return collect(environment, act, environment.reset(), num_steps, EpisodeLog(2))


def test_a_rollout_keeps_what_the_environment_overwrites():
    rollout = collected().rollout
    assert rollout.observation["state"][:, 1].tolist() == [[0, 1], [1, 1], [2, 1], [3, 1]]
    assert rollout.last_observation.tolist() == [[4, 0], [4, 1]]
    assert rollout.reward[:, 0].tolist() == [0, 1, 2, 3]
    assert rollout.valid.all()


def test_final_observations_are_kept_where_an_episode_was_cut_off():
    result = collected(truncated=[(1, 0), (3, 0), (3, 1)])
    assert result.final_rows.tolist() == [[102, 100], [104, 100], [104, 101]]
    assert list(zip(*result.final_places, strict=True)) == [(1, 0), (3, 0), (3, 1)]
    values = value_of_cut_off(lambda normaliser, parameters, rows: rows["privileged_state"][:, 0], None, None, result)
    assert values.tolist() == [[0, 0], [102, 0], [0, 0], [104, 104]]


def test_termination_goes_before_a_time_limit():
    result = collected(truncated=[(1, 0)], terminated=[(1, 0)])
    assert not result.rollout.truncated.any()
    assert len(result.final_rows) == 0


def test_a_diverged_step_is_not_valid():
    rollout = collected(invalid=[(2, 1)]).rollout
    assert np.argwhere(~rollout.valid).tolist() == [[2, 1]]
    assert rollout.reward[2].tolist() == [2, 0]


def test_steps_from_and_to_an_observation_that_is_not_finite_are_not_valid():
    rollout = collected(broken=[(1, 0)]).rollout
    assert np.argwhere(~rollout.valid).tolist() == [[1, 0], [2, 0]]
    assert np.isfinite(rollout.observation["state"]).all()


def test_a_broken_observation_after_the_end_of_an_episode_leaves_the_end_valid():
    rollout = collected(broken=[(1, 0)], terminated=[(1, 0)]).rollout
    assert np.argwhere(~rollout.valid).tolist() == [[2, 0]]


def test_finite_rows_are_not_copied():
    observation = {"state": np.ones((2, 3), np.float32)}
    clean, is_finite = finite_rows(observation)
    assert clean is observation
    assert is_finite.all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_rows_with_one_broken_number_are_found(value):
    rows = np.ones((2, 3), np.float32)
    rows[1, 2] = value
    clean, is_finite = finite_rows({"state": np.ones((2, 1), np.float32), "privileged_state": rows})
    assert is_finite.tolist() == [True, False]
    assert clean["state"].tolist() == [[1], [0]]


def test_episodes_are_summed_over_rollouts_and_broken_ones_forgotten():
    log = EpisodeLog(2)
    environment = Scripted(truncated=[(2, 0), (2, 1)], invalid=[(0, 1)])
    first = collect(environment, act, environment.reset(), 2, log)
    assert log.summary()["return"] is None
    collect(environment, act, first.observation, 2, log)
    summary = log.summary()
    assert summary["episodes"] == 2
    assert summary["return"] == 3.0  # 0 + 1 + 2, and 1 + 2 of the copy that lost its first step
    assert summary["env/m"] == 2.5
    assert summary["env_end/m"] == 2.0
