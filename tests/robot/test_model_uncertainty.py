import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from settled import ARM, settled_rows

from qjrl.geometry.pose import row_errors
from qjrl.learning.fitting import FitConfig
from qjrl.learning.networks import NetworkConfig
from qjrl.robot.forward_model import (
    ForwardModel,
    ForwardModelConfig,
    load_forward_model,
    pose_function,
    save_forward_model,
)
from qjrl.robot.model_fitting import fit_forward_model
from qjrl.robot.model_uncertainty import coverage, coverage_curve, pose_and_sigma, sigma_factor

SINGLE = ForwardModelConfig(
    "corrected",
    NetworkConfig(width=16, num_blocks=1, num_frequencies=0, zero_output=True),
    FitConfig(epochs=8, batch_size=8, evaluate_every=4),
    held_out=0.4,
)
ENSEMBLE = dataclasses.replace(SINGLE, ensemble=3)
LENGTHS = settled_rows()["cable_lengths"][:10]


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    return fit_forward_model(ARM, ENSEMBLE, settled_rows(), 0, tmp_path_factory.mktemp("ensemble"))


def members(model):
    for index in range(model.config.ensemble):
        parameters = jax.tree.map(lambda leaf, index=index: leaf[index], model.fitted.parameters)
        alone = dataclasses.replace(model.fitted, parameters=parameters, num_members=1)
        yield ForwardModel(alone, dataclasses.replace(model.config, ensemble=1))


def poses_of(model):
    return np.asarray(jax.jit(jax.vmap(pose_function(ARM, model)))(jnp.asarray(LENGTHS)))


def estimates_of(model):
    return jax.jit(jax.vmap(pose_and_sigma(ARM, model)))(jnp.asarray(LENGTHS))


def errors_with(sigma, seed):
    """Norms of three independent normal numbers of a standard deviation each."""
    return np.linalg.norm(np.random.default_rng(seed).normal(size=(len(sigma), 3)) * sigma[:, None], axis=1)


def test_the_factor_of_known_noise_is_recovered_and_every_interval_holds_what_it_promises():
    spread = np.random.default_rng(0).uniform(1e-5, 1e-3, 20_000)
    factor = sigma_factor(spread, errors_with(2.5 * spread, seed=1))
    assert factor == pytest.approx(2.5, rel=0.02)
    levels, shares = coverage_curve(factor * spread, errors_with(2.5 * spread, seed=2))
    np.testing.assert_allclose(shares, levels, atol=0.015)


def test_coverage_by_hand():
    """The 90 % interval of three normal numbers of deviation 1 has the radius 2.5003."""
    assert coverage(np.ones(4), np.array([0.1, 2.4, 2.6, 9.0]), (0.9,)).tolist() == [0.5]


def test_the_spread_is_the_members_standard_deviation_about_the_mean_times_the_factor(fitted):
    model, _ = fitted
    estimate = estimates_of(model)
    poses = np.array([poses_of(member) for member in members(model)])
    errors = np.array([row_errors(pose, estimate.pose) for pose in poses])  # (members, 2, rows)
    expected = np.sqrt(np.sum(errors**2, axis=0) / (3 * 2)) * np.asarray(model.sigma_factors)[:, None]
    np.testing.assert_allclose(estimate.position_sigma, expected[0], rtol=1e-3)
    np.testing.assert_allclose(estimate.orientation_sigma, expected[1], rtol=1e-3)
    assert np.asarray(estimate.position_sigma).min() > 1e-7  # the members differ
    np.testing.assert_array_equal(estimate.pose, poses_of(model))


def test_the_metrics_say_how_well_the_intervals_cover(fitted):
    uncertainty = fitted[1]["uncertainty"]
    assert uncertainty.keys() == {"position", "orientation"}
    for report, factor in zip(uncertainty.values(), fitted[0].sigma_factors, strict=True):
        assert report["factor"] == pytest.approx(float(factor)) and factor > 0
        assert 50 <= report["coverage_90_percent"] <= 100
        assert np.all(np.diff(report["shares"]) >= 0)


def test_a_saved_ensemble_comes_back_with_its_factors(fitted, tmp_path):
    model, _ = fitted
    save_forward_model(tmp_path / "model", ARM, model)
    back = load_forward_model(tmp_path / "model", ARM)
    jax.tree.map(np.testing.assert_array_equal, estimates_of(back), estimates_of(model))


def test_a_single_network_has_no_uncertainty(fitted):
    with pytest.raises(ValueError, match="ensemble: got 1, allowed: 2 or more"):
        pose_and_sigma(ARM, next(members(fitted[0])))
