"""Data and settings that the tests of Gaussian processes share."""

from typing import Any

import jax
import numpy as np
import sklearn.gaussian_process
import sklearn.gaussian_process.kernels

from qjrl.learning.gaussian_process.hyperparameters import Hyperparameters
from qjrl.learning.gaussian_process.posterior import condition, mean_and_variance, noise_variance
from qjrl.learning.gaussian_process.rows import no_scaling

# Of scikit-learn, whose annotations say less than it takes.
Regressor: Any = sklearn.gaussian_process.GaussianProcessRegressor
kernels: Any = sklearn.gaussian_process.kernels

predict = jax.jit(jax.vmap(mean_and_variance, (None, 0)))


def rows(count, num_inputs=3, num_outputs=2, noise=0.05, seed=0):
    """Smooth functions of uniform inputs, measured with noise."""
    rng = np.random.default_rng(seed)
    inputs = rng.uniform(-2.0, 2.0, (count, num_inputs))
    waves = np.sin(inputs @ np.random.default_rng(99).normal(size=(num_inputs, 12)) * 0.6)
    targets = waves @ np.random.default_rng(98).normal(size=(12, num_outputs))
    return inputs, targets + noise * rng.normal(size=targets.shape)


def one_group(length_scales, signal=1.3, noise=0.1, shape=1.0):
    return Hyperparameters(*(np.array([value], np.float64) for value in (length_scales, signal, noise, shape)))


def unscaled(kernel, hyperparameters, inputs, targets):
    return condition(kernel, hyperparameters, no_scaling(inputs.shape[1], targets.shape[1]), inputs, targets)


def predicted(process, inputs):
    """Mean and standard deviation (n, outputs) of what is measured at inputs (n, d)."""
    mean, variance = predict(process, inputs)
    return np.asarray(mean), np.sqrt(variance + noise_variance(process))
