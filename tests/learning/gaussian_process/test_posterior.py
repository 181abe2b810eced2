import dataclasses

import jax
import numpy as np
import pytest
from processes import Regressor, kernels, one_group, predicted, rows, unscaled
from scipy.stats import norm

from qjrl.learning.gaussian_process.covariance import factor, measured_covariance
from qjrl.learning.gaussian_process.kernels import KERNELS
from qjrl.learning.gaussian_process.posterior import groups_of, mean, mean_only

SCALES = np.array([1.4, 0.8, 2.5])
THEIRS = {
    "squared_exponential": (SCALES, kernels.RBF(SCALES)),
    "matern_52": (SCALES, kernels.Matern(SCALES, nu=2.5)),
    "rational_quadratic": (np.full(3, 1.4), kernels.RationalQuadratic(1.4, alpha=0.7)),
}


@pytest.mark.parametrize("name", KERNELS)
def test_mean_and_deviation_are_those_of_scikit_learn(name):
    (inputs, targets), (scales, kernel) = rows(80), THEIRS[name]
    theirs = Regressor(
        kernels.ConstantKernel(1.3**2) * kernel + kernels.WhiteKernel(0.1**2), alpha=1e-9 * 1.3**2, optimizer=None
    ).fit(inputs, targets)
    at = rows(50, seed=1)[0]
    found = predicted(unscaled(name, one_group(scales, shape=0.7), inputs, targets), at)
    for ours, other in zip(found, theirs.predict(at, return_std=True), strict=True):
        np.testing.assert_allclose(ours, other, atol=1e-8)


@pytest.mark.parametrize("name", KERNELS)
def test_without_noise_it_goes_through_its_rows_and_is_sure_of_them(name):
    inputs, targets = rows(40, noise=0.0)
    process = unscaled(name, one_group(SCALES, noise=0.0), inputs, targets)
    found, sigma = predicted(process, inputs)
    np.testing.assert_allclose(found, targets, atol=2e-5)  # the jitter is noise of 4e-5
    assert sigma.max() < 1e-4 < predicted(process, 4.0 + inputs)[1].min()


def coverages(noise_factor):
    """Shares of measurements inside the intervals of 50, 90 and 95 %, one measurement of each of 200 draws from the prior."""
    rng = np.random.default_rng(5)
    truth = one_group(np.array([1.0, 0.6]), signal=1.0, noise=0.3)
    believed = dataclasses.replace(truth, noise=truth.noise * noise_factor)
    off = []
    for _ in range(200):
        inputs = rng.uniform(-1.0, 1.0, (31, 2))
        drawn = factor(measured_covariance("matern_52", groups_of(truth)[0], inputs)) @ rng.normal(size=(31, 1))
        found, sigma = predicted(unscaled("matern_52", believed, inputs[:30], drawn[:30]), inputs[30:])
        off.append(abs(found - drawn[30])[0, 0] / sigma[0, 0])
    return np.mean(np.array(off)[:, None] <= norm.ppf([0.75, 0.95, 0.975]), axis=0)


def test_intervals_hold_what_they_promise_on_draws_from_the_prior_and_a_wrong_noise_is_seen():
    promised = np.array([0.5, 0.9, 0.95])
    allowed = 3.0 * np.sqrt(promised * (1.0 - promised) / 200)
    assert np.all(np.abs(coverages(1.0) - promised) < allowed)
    assert np.all(np.abs(coverages(0.4) - promised) > allowed)
    assert np.all(np.abs(coverages(2.5) - promised)[:2] > allowed[:2])


def test_outputs_with_hyperparameters_of_their_own_are_as_many_processes():
    inputs, targets = rows(40)
    groups = [one_group(SCALES, noise=0.1), one_group(2.0 * SCALES, signal=0.7, noise=0.3)]
    both = jax.tree.map(lambda *leaves: np.concatenate(leaves), *groups)
    at = rows(9, seed=1)[0]
    found = predicted(unscaled("matern_52", both, inputs, targets), at)
    for output, group in enumerate(groups):
        alone = predicted(unscaled("matern_52", group, inputs, targets[:, output : output + 1]), at)
        for ours, other in zip(found, alone, strict=True):
            np.testing.assert_allclose(ours[:, output : output + 1], other, atol=1e-12)


def test_the_mean_needs_no_factor_and_answers_the_same():
    inputs, targets = rows(40)
    process = unscaled("squared_exponential", one_group(SCALES), inputs, targets)
    assert mean_only(process).cholesky is None
    np.testing.assert_allclose(mean(mean_only(process), inputs[0]), predicted(process, inputs[:1])[0][0], atol=1e-13)
    slope = jax.jit(jax.jacfwd(mean, argnums=1))(process, inputs[0])
    ends = [predicted(process, inputs[0] + sign * 1e-6 * np.eye(3))[0] for sign in (1, -1)]
    np.testing.assert_allclose(slope.T, (ends[0] - ends[1]) / 2e-6, atol=1e-6)
