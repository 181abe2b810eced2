import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, VectorEnv
from worlds import ARM, CONFIG, NUM_ENVS, environment, random_actions

from qjrl.control.gymnasium_adapter import ResidualEnv, ResidualVectorEnv
from qjrl.learning.ppo.environment import CRITIC_KEY


@pytest.fixture(scope="module")
def arms():
    return ResidualVectorEnv(environment())


@pytest.fixture(scope="module")
def arm():
    return ResidualEnv(environment(num_envs=1))


def test_gymnasiums_own_checker_accepts_one_arm(arm):
    check_env(arm, skip_render_check=True)


def test_an_episode_of_one_arm_is_whole_and_ends_with_its_last_observation(arm):
    observation, info = arm.reset(seed=1)
    assert observation in arm.observation_space and info[CRITIC_KEY].ndim == 1
    for step in range(1, CONFIG.episode_steps + 1):
        before = observation
        observation, reward, terminated, truncated, info = arm.step(np.zeros(ARM.num_cables, np.float32))
        assert not terminated and truncated == (step == CONFIG.episode_steps) and info["valid"]
        assert np.any(observation != before) and np.isfinite(reward)


def test_the_vector_environment_says_how_it_resets_and_keeps_its_spaces(arms):
    assert isinstance(arms, VectorEnv) and arms.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, info = arms.reset(seed=0)
    assert observation in arms.observation_space and info[CRITIC_KEY].shape[0] == NUM_ENVS
    assert arms.action_space.shape == (NUM_ENVS, ARM.num_cables)
    assert random_actions(1)[0] in arms.action_space


def test_the_same_seed_is_the_same_and_none_is_another(arms):
    first, _ = arms.reset(seed=3)
    other, _ = arms.reset()
    again, _ = arms.reset(seed=3)
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_arms_that_end_begin_anew_in_the_same_step_and_show_their_last_observation(arms):
    arms.reset(seed=5)
    for actions in random_actions(CONFIG.episode_steps - 1):
        assert "final_obs" not in arms.step(actions)[-1]
    observation, _, terminated, truncated, info = arms.step(random_actions(1)[0])
    assert truncated.all() and not terminated.any() and info["_final_obs"].all()
    assert np.any(info["final_obs"] != observation, axis=1).all()
    assert np.isfinite(info["position_error"]).all()


def test_a_diverged_arm_is_truncated_where_it_was_last_sound(arms):
    arms.reset(seed=6)
    before = arms.step(random_actions(1)[0])[0]
    broken = random_actions(1, 1)[0]
    broken[2] = np.nan
    observation, reward, terminated, truncated, info = arms.step(broken)
    assert truncated.tolist() == [False, False, True, False] and not terminated.any()
    assert info["valid"].tolist() == [True, True, False, True] and reward[2] == 0.0
    np.testing.assert_array_equal(info["final_obs"][2], before[2])
    assert np.isfinite(observation).all()


def test_one_arm_means_one():
    with pytest.raises(ValueError, match="environment: got 4 arms, allowed: 1"):
        ResidualEnv(environment())
