"""Against scikit-learn, whose parameters are variances where ours are standard deviations."""

import math
from typing import Any

import numpy as np
import pytest
from processes import Regressor, kernels, rows
from scipy.optimize import approx_fprime

from qjrl.learning.gaussian_process import covariance
from qjrl.learning.gaussian_process.likelihood import log_marginal_likelihood

SCALES = np.array([1.4, 0.8, 2.5])
THEIRS = {
    "squared_exponential": lambda scales: kernels.RBF(scales),
    "matern_52": lambda scales: kernels.Matern(scales, nu=2.5),
    "rational_quadratic": lambda scales: kernels.RationalQuadratic(scales, alpha=0.7),
}


def theirs(name, scales, inputs, targets, signal, noise):
    jitter = kernels.WhiteKernel(covariance.JITTER, "fixed")
    kernel = kernels.ConstantKernel(signal**2) * (THEIRS[name](scales) + jitter) + kernels.WhiteKernel(noise**2)
    return Regressor(kernel, alpha=0.0, optimizer=None).fit(inputs, targets)


CASES = [
    ("squared_exponential", SCALES),
    ("squared_exponential", 1.4),
    ("matern_52", SCALES),
    ("matern_52", 1.4),
    ("rational_quadratic", 1.4),
]


@pytest.mark.parametrize(("name", "scales"), CASES, ids=str)
@pytest.mark.parametrize("noise", [0.3, 0.01])
def test_value_and_gradient_are_those_of_scikit_learn(name, scales, noise):
    inputs, targets = rows(60, num_outputs=6)
    signal = 1.3
    model = theirs(name, scales, inputs, targets, signal, noise)
    value, gradient = model.log_marginal_likelihood(model.kernel_.theta, eval_gradient=True)
    shape = [0.7] if name == "rational_quadratic" else []
    logs = np.log(np.concatenate([np.atleast_1d(scales), [signal, noise], shape]))
    ours, slopes = log_marginal_likelihood(name, logs, inputs, targets)
    if shape:  # theirs: signal, shape, scale, noise
        gradient = gradient[[0, 2, 3, 1]]
        expected = [gradient[1], 2.0 * gradient[0], 2.0 * gradient[2], gradient[3]]
    else:
        expected = [*gradient[1:-1], 2.0 * gradient[0], 2.0 * gradient[-1]]
    assert ours == pytest.approx(value, rel=1e-11)
    np.testing.assert_allclose(slopes, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


def test_a_length_scale_an_input_of_the_rational_quadratic_has_the_slopes_of_differences():
    inputs, targets = rows(40)
    logs = np.log([*SCALES, 1.3, 0.2, 0.7])
    value = lambda at: log_marginal_likelihood("rational_quadratic", at, inputs, targets)[0]  # noqa: E731
    slopes = log_marginal_likelihood("rational_quadratic", logs, inputs, targets)[1]
    differences: Any = approx_fprime(logs, value, 1e-6)
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1e-3)


def test_what_is_not_positive_definite_is_refused_by_an_infinite_value(monkeypatch):
    monkeypatch.setattr(covariance, "JITTER", -1.5)
    value, slopes = log_marginal_likelihood("matern_52", np.log([1.0, 1.0, 0.1]), *rows(12))
    assert value == -math.inf
    np.testing.assert_array_equal(slopes, 0.0)
