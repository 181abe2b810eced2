"""Each probe has an exact expectation; the tolerances are what a few seconds of training reach."""

import jax
import numpy as np
import pytest
from probe_environments import ProbeEnvironment, a_sign, nothing, the_time

from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.episodes import EpisodeLog
from qjrl.learning.ppo.iteration import compile_functions, run_iteration
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.learning.ppo.training_state import Session, initial_state, policy_of

DISCOUNT = 0.8
VALUE_TOLERANCE = 0.02
ACTION_TOLERANCE = 0.02

CONFIG = PPOConfig(
    unroll_length=10,
    num_minibatches=4,
    discount=DISCOUNT,
    entropy_cost=0.0,
    learning_rate=3e-3,
    critic_learning_rate=3e-3,
    actor_layers=(16,),
    critic_layers=(16,),
)


@pytest.fixture(scope="module")
def learn():
    """Trains on a probe; all probes share one compilation."""
    compiled = compile_functions(CONFIG, ProbeEnvironment(nothing, lambda seen, action: seen))

    def train(environment, iterations):
        state = initial_state(compiled.initialise, CONFIG, environment, seed=0)
        session = Session(state, environment.reset(), environment, EpisodeLog(environment.num_envs))
        for _ in range(iterations):
            session, _ = run_iteration(session, compiled, CONFIG, iterations)
        return session.state

    def values(state, *observations):
        rows = {"privileged_state": np.array(observations, np.float32)[:, None]}
        return np.asarray(compiled.value(state.normaliser, state.learner.parameters["value"], rows))

    def actions(state, *observations):
        return np.asarray(
            jax.jit(deterministic_action)(policy_of(state, CONFIG), np.array(observations, np.float32)[:, None])
        )[:, 0]

    return train, values, actions


def test_a_constant_reward_is_valued(learn):
    train, values, _ = learn
    state = train(ProbeEnvironment(nothing, lambda seen, action: np.ones_like(seen)), 30)
    assert values(state, 0) == pytest.approx([1], abs=VALUE_TOLERANCE)


def test_a_reward_that_depends_on_the_observation_is_valued(learn):
    train, values, _ = learn
    state = train(ProbeEnvironment(a_sign, lambda seen, action: seen), 40)
    assert values(state, -1, 1) == pytest.approx([-1, 1], abs=VALUE_TOLERANCE)


def test_a_later_reward_is_discounted(learn):
    train, values, _ = learn
    state = train(ProbeEnvironment(the_time, lambda seen, action: seen, length=2), 40)
    assert values(state, 0, 1) == pytest.approx([DISCOUNT, 1], abs=VALUE_TOLERANCE)


def test_a_time_limit_does_not_end_the_value(learn):
    """Reward 1 for ever: 1 / (1 - 0.8) = 5, although episodes are cut off after 3 steps."""
    train, values, _ = learn
    state = train(ProbeEnvironment(nothing, lambda seen, action: np.ones_like(seen), length=3, truncates=True), 80)
    assert values(state, 0) == pytest.approx([5], abs=3 * VALUE_TOLERANCE)


def test_the_policy_finds_the_best_action(learn):
    train, _, actions = learn
    state = train(ProbeEnvironment(nothing, lambda seen, action: -np.square(action - 0.5)), 40)
    assert actions(state, 0) == pytest.approx([0.5], abs=ACTION_TOLERANCE)


def test_the_policy_finds_the_best_action_for_each_observation(learn):
    train, values, actions = learn
    state = train(ProbeEnvironment(a_sign, lambda seen, action: seen - np.square(action - 0.5 * seen)), 40)
    assert actions(state, -1, 1) == pytest.approx([-0.5, 0.5], abs=ACTION_TOLERANCE)
    assert values(state, -1, 1) == pytest.approx([-1, 1], abs=2 * VALUE_TOLERANCE)  # less the remaining exploration
