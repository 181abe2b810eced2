import tomllib
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import worlds
from gymnasium.envs.registration import namespace, registry
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, VectorEnv
from worlds import ARM, CONFIG, ENGINE, NUM_ENVS, random_actions, shared_env

from qjrl.control import gymnasium_adapter, gymnasium_registration
from qjrl.control.gymnasium_adapter import ResidualArmEnv, ResidualVectorEnv
from qjrl.learning.ppo.environment import CRITIC_KEY


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """The programs that other tests have compiled, those of the same functions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gymnasium_adapter, "_reset", worlds._reset)
        patch.setattr(gymnasium_adapter, "_step", worlds._step)
        yield


@pytest.fixture(scope="module")
def arms():
    return ResidualVectorEnv(shared_env(), NUM_ENVS)


@pytest.fixture(scope="module")
def arm():
    return ResidualArmEnv(shared_env())


def test_gymnasiums_own_checker_accepts_one_arm(arm):
    check_env(arm, skip_render_check=True)


def test_an_episode_of_one_arm_is_whole_and_ends_with_its_last_observation(arm):
    observation, info = arm.reset(seed=1)
    assert observation in arm.observation_space and info[CRITIC_KEY].ndim == 1
    for step in range(1, CONFIG.episode_steps + 1):
        before = observation
        observation, reward, terminated, truncated, info = arm.step(np.zeros(ARM.num_cables, np.float32))
        assert not terminated and truncated == (step == CONFIG.episode_steps) and info["valid"]
        assert np.any(observation != before) and np.isfinite(float(reward))


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


@pytest.mark.parametrize("make", [lambda: ResidualArmEnv(shared_env()), lambda: ResidualVectorEnv(shared_env(), 4)])
def test_a_step_before_the_first_reset_is_one_line(make):
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"^step: the environment has not been reset"):
        make().step(random_actions(1)[0])


@pytest.fixture
def registered():
    """As Gymnasium's entry point does it."""
    with namespace("qjrl"):
        gymnasium_registration.register()
    yield
    del registry["qjrl/Residual-v0"]


def test_the_package_registers_itself_by_an_entry_point():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    register = gymnasium_registration.register
    entry = f"{register.__module__}:{register.__name__}"
    assert project["entry-points"]["gymnasium.envs"] == {"qjrl": entry}


def test_many_arms_of_a_shipped_robot_are_made_by_name(registered):
    arms = gymnasium.make_vec("qjrl/Residual-v0", num_envs=2, robot="qj_22", num_targets=16)
    observation, _ = arms.reset(seed=0)
    assert observation.shape == arms.observation_space.shape and observation.shape[0] == arms.num_envs == 2
    assert arms.action_space.shape == (2, 6) and np.isfinite(observation).all()  # the default residual moves the tip


def test_one_arm_is_made_by_name_and_steps(registered):
    made = gymnasium.make("qjrl/Residual-v0", robot="qj_22", config=CONFIG, engine=ENGINE, num_targets=256)
    observation, _ = made.reset(seed=0)
    following, reward, terminated, truncated, info = made.step(np.zeros(ARM.num_cables, np.float32))
    assert observation in made.observation_space and np.any(following != observation) and np.isfinite(float(reward))
    assert not terminated and not truncated and info["valid"]
