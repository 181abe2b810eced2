"""The estimate: against the algebra that it stands for, and better than the mean where arms are as believed."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named

from qjrl.control import arm_estimate, controller
from qjrl.control.arm_estimate import EstimateConfig, Prior
from qjrl.control.bases import environment_of
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.observations import held_reading
from qjrl.control.sensors import exact_reading
from qjrl.control.tip_correction import sensed_pose, tip_error
from qjrl.robot import cable_lengths, equilibrium, forward_kinematics

ARM = arm_named("qj_22")
CONFIG = EstimateConfig()
LENGTHS = cable_lengths(ARM, jnp.array([[0.25, 0.1], [-0.2, 0.3]]))
BELIEVED = jax.jit(arm_estimate.prior, static_argnums=0)(CONFIG, ARM, LENGTHS)
NOISE = math.radians(CONFIG.encoder_noise_deg) / np.sqrt(2.0)  # two joints a segment


def estimated(mean, count, believed=BELIEVED):
    return np.asarray(arm_estimate.estimate(CONFIG, ARM, believed, jnp.asarray(mean), jnp.asarray(float(count))))


def test_what_is_expected_is_believed():
    np.testing.assert_allclose(estimated(BELIEVED.expected, 5), BELIEVED.expected, atol=1e-12)


def test_countless_readings_are_believed_over_the_prior():
    mean = BELIEVED.expected + 0.003 * np.random.default_rng(0).normal(size=(2, 2))
    np.testing.assert_allclose(estimated(mean, 1e12), mean, atol=1e-6)


def test_knowing_next_to_nothing_leaves_the_mean():
    mean = np.array([[0.01, -0.02], [0.0, 0.03]])
    vague = Prior(BELIEVED.expected, 1e10 * BELIEVED.covariance)
    np.testing.assert_allclose(estimated(mean, 3, vague), mean, atol=1e-5)


def test_where_nothing_can_be_believed_the_mean_is_taken():
    mean = np.array([[0.01, -0.02], [0.0, 0.03]])
    nowhere = arm_estimate.priors(CONFIG, ARM, jnp.full((2, ARM.num_cables), jnp.nan))
    np.testing.assert_allclose(estimated(mean, 3, jax.tree.map(lambda rows: rows[0], nowhere)), mean, rtol=1e-5)


def test_it_is_the_mean_of_the_posterior():
    """As Gaussian regression of the causes has it, in whatever order they are counted."""
    rest, mean, count = jax.jit(equilibrium)(ARM, LENGTHS), np.array([[0.012, -0.02], [0.004, 0.03]]), 7
    turned = jax.jacfwd(lambda bends: exact_reading(ARM, bends))(rest.configuration).reshape(4, 4)
    causes = np.concatenate([np.reshape(part, (4, -1)) for part in (rest.by_pull, rest.by_tilt, rest.by_gain)], axis=1)
    weights = [CONFIG.friction] * 8 + [math.radians(CONFIG.tilt_deg)] * 2 + [CONFIG.gain]
    design = turned @ causes
    precision = np.diag(1.0 / np.square(weights)) + count / NOISE**2 * design.T @ design
    found = np.linalg.solve(precision, count / NOISE**2 * design.T @ np.reshape(mean - BELIEVED.expected, -1))
    expected = BELIEVED.expected + np.reshape(design @ found, (2, 2))
    np.testing.assert_allclose(estimated(mean, count), expected, atol=1e-9)


def test_it_errs_less_than_the_mean_by_what_it_says():
    """Arms drawn from the prior: the errors' covariance is P - P (P + 1/n)^-1 P, and smaller than the mean's 1/n."""
    rng, count, arms = np.random.default_rng(1), 20, 4000
    factor = np.linalg.cholesky(np.asarray(BELIEVED.covariance) + 1e-12 * np.eye(4))
    true = rng.normal(size=(arms, 4)) @ factor.T
    means = true + rng.normal(size=(arms, 4)) / math.sqrt(count)
    many = jax.vmap(lambda mean: arm_estimate.estimate(CONFIG, ARM, BELIEVED, mean, jnp.asarray(float(count))))
    found = np.asarray(many(jnp.asarray(BELIEVED.expected + NOISE * means.reshape(-1, 2, 2))))
    errors = ((found - BELIEVED.expected) / NOISE).reshape(-1, 4) - true
    prior = np.asarray(BELIEVED.covariance)
    left = prior - prior @ np.linalg.solve(prior + np.eye(4) / count, prior)
    np.testing.assert_allclose(errors.T @ errors / arms, left, atol=0.1 * np.max(left))
    assert np.trace(left) < 0.8 * 4 / count


def test_many_priors_are_each_arm_s_own():
    lengths = jnp.stack([LENGTHS, 0.3 * LENGTHS])
    together = arm_estimate.priors(CONFIG, ARM, lengths)
    for row, one in enumerate(lengths):
        alone = arm_estimate.prior(CONFIG, ARM, one)
        for field in dataclasses.fields(Prior):
            np.testing.assert_allclose(
                getattr(together, field.name)[row], getattr(alone, field.name), rtol=1e-6, atol=1e-9
            )


@pytest.fixture(scope="module")
def config():
    return environment_of(EnvironmentConfig(), "estimate").controller


@pytest.fixture(scope="module")
def settled(config):
    """A controller that has waited at a target 10 mm off, its next reading being what is believed: state and reading."""
    target = forward_kinematics(ARM, jnp.array([[0.26, 0.1], [-0.2, 0.3]]))
    task = dataclasses.replace(controller.task_of(config, ARM, target, LENGTHS), prior=BELIEVED)
    state = controller.begin(config, ARM, task)
    memory = jnp.broadcast_to(state.expected, state.memory.shape)
    state = dataclasses.replace(state, command=LENGTHS, memory=memory, step=jnp.asarray(149, jnp.int32))
    return state, held_reading(ARM, LENGTHS) + BELIEVED.expected


def test_the_tip_lacks_by_the_estimate_what_it_lacks_where_the_arm_is_believed_to_rest(config, settled):
    before, reading = settled
    expected = tip_error(sensed_pose(ARM, reading), before.target)
    found = controller.sense(config, ARM, before, reading)
    np.testing.assert_allclose(found.estimated, BELIEVED.expected, atol=1e-12)
    np.testing.assert_allclose(found.tip_error, expected, atol=1e-12)
    assert np.abs(expected).max() > 1e-3
    early = dataclasses.replace(before, step=jnp.asarray(0, jnp.int32))
    assert not np.any(controller.sense(config, ARM, early, reading).tip_error)


def test_the_controller_s_own_action_makes_up_for_that_and_only_if_it_shall(config, settled):
    state = controller.sense(config, ARM, *settled)
    own = config.residual.bound * controller.own_action(config, state)
    np.testing.assert_allclose(own, state.tip_error, atol=1e-12)
    still = dataclasses.replace(config, estimate=dataclasses.replace(config.estimate, acts=False))
    state = dataclasses.replace(state, gains=controller.gains_of(still, float))
    np.testing.assert_array_equal(controller.own_action(still, state), np.zeros(6))
