import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from customary import customary_ppo

from qjrl.learning.ppo.networks import initial_parameters, make_networks
from qjrl.learning.ppo.normaliser import initial_normaliser, update_normaliser
from qjrl.learning.ppo.rollout import Rollout
from qjrl.learning.ppo.update import adapted_rate, gradient_step, make_learner, make_update, minibatches

CONFIG = customary_ppo(num_minibatches=3, num_epochs=2, actor_layers=(8,), critic_layers=(8,))
SIZES = {"state": 3, "privileged_state": 4}
STEPS, ENVS, ACTIONS = 5, 4, 2


def rollout(seed=0):
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return rng.standard_normal(shape, np.float32)

    return Rollout(
        observation={name: normal(STEPS, ENVS, size) for name, size in SIZES.items()},
        action=np.zeros((STEPS, ENVS, ACTIONS), np.float32),
        raw_action=0.3 * normal(STEPS, ENVS, ACTIONS),
        logits=np.zeros((STEPS, ENVS, 2 * ACTIONS), np.float32),
        log_probability=normal(STEPS, ENVS) - 1,
        reward=normal(STEPS, ENVS),
        terminated=np.zeros((STEPS, ENVS), bool),
        truncated=np.zeros((STEPS, ENVS), bool),
        valid=np.ones((STEPS, ENVS), bool),
        final_value=np.zeros((STEPS, ENVS), np.float32),
    )


def last_observation():
    return np.random.default_rng(1).standard_normal((ENVS, 4), np.float32)


@pytest.fixture(scope="module")
def update():
    """One update of an untrained learner: rollout -> (learner, metrics, normaliser)."""
    networks = make_networks(CONFIG, SIZES, ACTIONS)
    parameters = jax.jit(lambda key: initial_parameters(networks, 0.3, key))(jax.random.key(0))
    compiled = jax.jit(make_update(networks, CONFIG))

    def run(rollout, moves_actor=True):
        learner = make_learner(CONFIG, parameters)
        normaliser = jax.jit(update_normaliser)(initial_normaliser(SIZES), rollout.observation, rollout.valid)
        last, key = last_observation(), jax.random.key(1)
        return *compiled(learner, normaliser, rollout, last, key, jnp.bool_(moves_actor)), normaliser

    return run


def same_bits(one, other):
    return all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True))


def test_what_stands_in_invalid_rows_changes_nothing(update):
    clean = rollout()
    clean.valid[2, 1] = clean.valid[0, 3] = False
    clean.reward[~clean.valid] = 0
    other = jax.tree.map(np.copy, clean)
    for rows in (*other.observation.values(), other.raw_action, other.log_probability):
        rows[0, 3] = 1.5
    assert same_bits(update(clean), update(other))


def test_a_valid_row_changes_the_update(update):
    other = rollout()
    other.reward[4, 3] += 1
    assert not same_bits(update(rollout())[0], update(other)[0])


def test_while_the_critic_warms_up_the_actor_stands_still_and_so_does_the_rate(update):
    before, after = update(rollout())[0], update(rollout(), moves_actor=False)[0]
    assert same_bits(before.parameters["value"], after.parameters["value"])
    networks = make_networks(CONFIG, SIZES, ACTIONS)
    untrained = jax.jit(lambda key: initial_parameters(networks, 0.3, key))(jax.random.key(0))
    assert same_bits(after.parameters["policy"], untrained["policy"])
    assert not same_bits(before.parameters["policy"], untrained["policy"])
    assert float(after.learning_rate) == pytest.approx(CONFIG.learning_rate)


def test_nothing_of_a_learner_is_float64(update):
    learner, _, normaliser = update(rollout())
    dtypes = {leaf.dtype for leaf in jax.tree.leaves((learner, normaliser))}
    assert dtypes == {np.dtype(np.float32), np.dtype(np.int32), np.dtype(np.uint32)}


def test_every_metric_is_finite(update):
    metrics = update(rollout())[1]
    assert all(np.isfinite(value) for value in metrics.values())


def test_an_epoch_uses_no_row_twice():
    order = np.asarray(minibatches(CONFIG, 20, jax.random.key(0)))
    assert order.shape == (2 * 3, 6)
    assert len(set(order[:3].ravel())) == len(set(order[3:].ravel())) == 18
    assert not np.array_equal(order[:3], order[3:])


@pytest.mark.parametrize(
    ("kl", "rate"),
    [(0.021, 1e-3 / 1.5), (0.019, 1e-3), (0.006, 1e-3), (0.004, 1e-3 * 1.5)],
)
def test_the_rate_follows_the_divergence(kl, rate):
    config = dataclasses.replace(CONFIG, target_kl=0.01)
    assert float(adapted_rate(config, jnp.float32(1e-3), jnp.float32(kl))) == pytest.approx(rate)


def test_the_rate_stays_within_its_bounds():
    assert float(adapted_rate(CONFIG, jnp.float32(1e-5), jnp.float32(1))) == pytest.approx(CONFIG.min_learning_rate)
    assert float(adapted_rate(CONFIG, jnp.float32(3e-3), jnp.float32(0))) == pytest.approx(CONFIG.max_learning_rate)


def test_the_gradients_of_actor_and_critic_are_clipped_each_by_its_norm():
    """(3, 4) has norm 5 and becomes (0.6, 0.8); (0.3, 0.4) is left alone. Adam's first moment is a tenth of either."""
    zeros = {"policy": jnp.zeros(2, jnp.float32), "value": jnp.zeros(2, jnp.float32)}
    gradient = {"policy": jnp.array([3, 4], jnp.float32), "value": jnp.array([0.3, 0.4], jnp.float32)}
    learner = gradient_step(CONFIG, make_learner(CONFIG, zeros), gradient)
    assert np.asarray(learner.optimiser_state.mu["policy"]) == pytest.approx([0.06, 0.08])
    assert np.asarray(learner.optimiser_state.mu["value"]) == pytest.approx([0.03, 0.04])


def test_a_first_step_of_adam_is_the_rate_of_actor_or_critic_against_the_gradient():
    config = dataclasses.replace(CONFIG, learning_rate=1e-4, critic_learning_rate=2e-3)
    zeros = {"policy": jnp.zeros(2, jnp.float32), "value": jnp.zeros(1, jnp.float32)}
    gradient = {"policy": jnp.array([0.5, -0.2], jnp.float32), "value": jnp.array([0.7], jnp.float32)}
    learner = gradient_step(config, make_learner(config, zeros), gradient)
    assert np.asarray(learner.parameters["policy"]) == pytest.approx([-1e-4, 1e-4], rel=1e-4)
    assert np.asarray(learner.parameters["value"]) == pytest.approx([-2e-3], rel=1e-4)
