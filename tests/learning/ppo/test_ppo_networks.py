import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.networks import initial_parameters, make_networks, start_at_zero
from qjrl.learning.ppo.normaliser import initial_normaliser, update_normaliser
from qjrl.learning.ppo.policy import ACTIVATIONS, Policy, deterministic_action, load_policy, save_policy

SIZES = {"state": 5, "privileged_state": 7}
ACTIONS = 3
OBSERVATION = jax.random.normal(jax.random.key(0), (4, 5), jnp.float32)


def make(activation: Any = "swish"):
    config = PPOConfig(activation=activation, actor_layers=(8, 6), critic_layers=(9,))
    return make_networks(config, SIZES, ACTIONS)


@pytest.fixture(scope="module")
def parameters():
    networks = make()
    return jax.jit(lambda key: initial_parameters(networks, 0.3, key))(jax.random.key(1))


def policy(parameters, activation="swish"):
    mean, std = jnp.full(5, 0.5, jnp.float32), jnp.full(5, 2.0, jnp.float32)
    return Policy(parameters["policy"]["params"], mean, std, activation=activation, observation_clip=10.0)


def test_the_untrained_policy_does_exactly_nothing(parameters):
    actions = deterministic_action(policy(parameters), 1e3 * OBSERVATION)
    assert np.array_equal(np.asarray(actions), np.zeros((4, ACTIONS)))


@pytest.mark.parametrize("std", [0.05, 0.3, 1.0])
def test_the_untrained_policy_explores_with_the_given_deviation(parameters, std):
    networks = make()
    started = {"params": start_at_zero(parameters["policy"]["params"], std)}
    logits = networks.policy_network.apply(initial_normaliser(SIZES), started, {"state": OBSERVATION})
    distribution: Any = networks.parametric_action_distribution.create_dist(logits)
    assert np.asarray(distribution.scale) == pytest.approx(std, rel=1e-5)


@pytest.mark.parametrize("activation", sorted(ACTIVATIONS))
def test_the_deterministic_action_is_the_mode_of_the_trained_network(parameters, activation):
    networks, rng = make(activation), np.random.default_rng(0)
    trained = jax.tree.map(lambda x: np.asarray(x) + 0.3 * rng.standard_normal(x.shape, np.float32), parameters)
    alone = policy(trained, activation)
    normaliser = dataclasses.replace(
        initial_normaliser(SIZES),
        mean={"state": alone.mean, "privileged_state": np.zeros(7)},
        std={"state": alone.std, "privileged_state": np.ones(7)},
    )
    logits = networks.policy_network.apply(normaliser, trained["policy"], {"state": OBSERVATION})
    mode = networks.parametric_action_distribution.mode(logits)
    assert np.asarray(deterministic_action(alone, OBSERVATION)) == pytest.approx(np.asarray(mode), abs=1e-6)


def test_a_policy_comes_back_from_its_files(parameters, tmp_path):
    before = policy(parameters, "elu")
    save_policy(tmp_path / "policy", before)
    after = load_policy(tmp_path / "policy")
    assert (after.activation, after.observation_clip) == ("elu", 10.0)
    jax.tree.map(np.testing.assert_array_equal, after, before)


def test_nothing_is_float64_although_x64_is_on(parameters):
    assert jax.config.read("jax_enable_x64")
    tree = (parameters, initial_normaliser(SIZES), deterministic_action(policy(parameters), np.zeros((1, 5))))
    assert {leaf.dtype for leaf in jax.tree.leaves(tree)} <= {np.dtype(np.float32), np.dtype(np.uint32)}


def test_the_normaliser_finds_mean_and_deviation_of_the_valid_rows():
    rng = np.random.default_rng(0)
    rows = {name: (3 + 2 * rng.standard_normal((6, 10, size))).astype(np.float32) for name, size in SIZES.items()}
    valid = rng.random((6, 10)) < 0.7
    normaliser = initial_normaliser(SIZES)
    for steps in (slice(0, 2), slice(2, 6)):  # in two pieces of different length
        part = {name: values[steps] for name, values in rows.items()}
        normaliser = jax.jit(update_normaliser)(normaliser, part, valid[steps])
    for name, values in rows.items():
        assert np.asarray(normaliser.mean[name]) == pytest.approx(values[valid].mean(axis=0), rel=1e-4)
        assert np.asarray(normaliser.std[name]) == pytest.approx(values[valid].std(axis=0), rel=1e-4)
    assert int(normaliser.count) == valid.sum()
    assert {leaf.dtype for leaf in jax.tree.leaves(normaliser)} == {np.dtype(np.float32), np.dtype(np.uint32)}
