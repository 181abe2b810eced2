"""Each probe has an exact expectation; the tolerances are what a few seconds of training reach."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from customary import customary_ppo
from probe_environments import NUM_ENVS, ProbeEnvironment, a_sign, nothing, the_time

from qjrl.learning.ppo.iteration import make_plan
from qjrl.learning.ppo.mesh import device_mesh
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.learning.ppo.programs import make_programs
from qjrl.learning.ppo.train import run_iteration
from qjrl.learning.ppo.trainer_state import policy_of

DISCOUNT = 0.8
VALUE_TOLERANCE = 0.02
ACTION_TOLERANCE = 0.02

CONFIG = customary_ppo(
    unroll_length=10,
    num_minibatches=4,
    discount=DISCOUNT,
    entropy_cost=0.0,
    learning_rate=3e-3,
    critic_learning_rate=3e-3,
    actor_layers=(16,),
    critic_layers=(16,),
)


def train(env, iterations):
    """A function of observations that gives the critic's values, and one that gives the actor's actions."""
    with jax.enable_x64(False):
        plan = make_plan(env, CONFIG, NUM_ENVS, iterations, device_mesh())
        programs = make_programs(plan)
        trainer = programs.begin(env, np.uint32(0))
        for _ in range(iterations):
            trainer, _ = run_iteration(plan, programs, env, trainer)

    def values(*observations):
        rows = {"privileged_state": np.array(observations, np.float32)[:, None]}
        network = plan.networks.value_network
        return np.asarray(network.apply(trainer.normaliser, trainer.learner.parameters["value"], rows))

    def actions(*observations):
        rows = np.array(observations, np.float32)[:, None]
        return np.asarray(jax.jit(deterministic_action)(policy_of(trainer, CONFIG), rows))[:, 0]

    return values, actions


def test_a_constant_reward_is_valued():
    values, _ = train(ProbeEnvironment(nothing, lambda seen, action: jnp.ones_like(seen)), 30)
    assert values(0) == pytest.approx([1], abs=VALUE_TOLERANCE)


def test_a_reward_that_depends_on_the_observation_is_valued():
    values, _ = train(ProbeEnvironment(a_sign, lambda seen, action: seen), 40)
    assert values(-1, 1) == pytest.approx([-1, 1], abs=VALUE_TOLERANCE)


def test_a_later_reward_is_discounted():
    values, _ = train(ProbeEnvironment(the_time, lambda seen, action: seen, length=2), 40)
    assert values(0, 1) == pytest.approx([DISCOUNT, 1], abs=VALUE_TOLERANCE)


def test_a_time_limit_does_not_end_the_value():
    """Reward 1 for ever: 1 / (1 - 0.8) = 5, although episodes are cut off after 3 steps."""
    env = ProbeEnvironment(nothing, lambda seen, action: jnp.ones_like(seen), length=3, truncates=True)
    values, _ = train(env, 80)
    assert values(0) == pytest.approx([5], abs=3 * VALUE_TOLERANCE)


def test_the_policy_finds_the_best_action():
    _, actions = train(ProbeEnvironment(nothing, lambda seen, action: -jnp.square(action - 0.5)), 40)
    assert actions(0) == pytest.approx([0.5], abs=ACTION_TOLERANCE)


def test_the_policy_finds_the_best_action_for_each_observation():
    values, actions = train(ProbeEnvironment(a_sign, lambda seen, action: seen - jnp.square(action - 0.5 * seen)), 40)
    assert actions(-1, 1) == pytest.approx([-0.5, 0.5], abs=ACTION_TOLERANCE)
    assert values(-1, 1) == pytest.approx([-1, 1], abs=2 * VALUE_TOLERANCE)  # less the remaining exploration
