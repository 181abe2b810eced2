import re

import numpy as np
import pytest
from processes import Regressor, kernels, predicted, rows

from qjrl.config import ConfigError
from qjrl.learning.gaussian_process import fit
from qjrl.learning.gaussian_process.fit import ProcessConfig, fit_process
from qjrl.learning.gaussian_process.kernels import KERNELS


@pytest.mark.parametrize("kernel", KERNELS)
def test_it_predicts_to_the_noise_and_finds_it(kernel):
    inputs, targets = rows(150)
    process, (report,) = fit_process(ProcessConfig(kernel), 1e-3 * inputs + 5.0, 40.0 * targets - 7.0)
    at, truth = rows(100, noise=0.0, seed=1)
    found, _ = predicted(process, 1e-3 * at + 5.0)
    assert np.sqrt(np.mean((found - (40.0 * truth - 7.0)) ** 2)) < 40.0 * 0.05
    noise = process.hyperparameters.noise[0] * process.scaling.output_std
    np.testing.assert_allclose(noise, 40.0 * 0.05, rtol=0.35)
    assert report.evaluations > 10 and report.start in (0, 1)


def test_its_likelihood_is_no_less_than_what_scikit_learn_reaches():
    inputs, targets = rows(60)
    standardised = [(one - one.mean(axis=0)) / one.std(axis=0) for one in (inputs, targets)]
    kernel = kernels.ConstantKernel(1.0, (1e-4, 1e4)) * kernels.RBF(np.full(3, 3.0), (1e-2, 1e3)) + kernels.WhiteKernel(
        1e-2, (1e-10, 1e2)
    )
    theirs = Regressor(kernel, alpha=1e-9).fit(*standardised)
    _, (report,) = fit_process(ProcessConfig(), inputs, targets)
    assert report.log_marginal_likelihood > theirs.log_marginal_likelihood_value_ - 1.0  # what the weak prior may cost


def test_many_rows_end_where_the_starts_on_all_of_them_end(monkeypatch):
    inputs, targets = rows(200)
    alone = fit_process(ProcessConfig(), inputs, targets)[1][0]
    monkeypatch.setattr(fit, "ROWS_OF_STARTS", 60)
    (report,) = fit_process(ProcessConfig(), inputs, targets)[1]
    assert report.log_marginal_likelihood == pytest.approx(alone.log_marginal_likelihood, abs=0.05)


def test_length_scales_are_as_many_as_asked_for():
    inputs, targets = rows(60)
    alike = fit_process(ProcessConfig(per_input=False), inputs, targets)[0].hyperparameters.length_scales
    assert alike.shape == (1, 3) and len(np.unique(alike)) == 1
    own = fit_process(ProcessConfig(length_scales="own"), inputs, targets)[0]
    assert own.hyperparameters.length_scales.shape == (2, 3) and own.cholesky.shape == (2, 60, 60)
    assert len(np.unique(own.hyperparameters.length_scales)) == 6


def test_an_input_without_influence_gets_a_long_length_scale_and_one_that_does_not_change_does_no_harm():
    inputs, targets = rows(100)
    rng = np.random.default_rng(3)
    more = np.column_stack([inputs, rng.normal(size=100), np.full(100, 3.0)])
    process, _ = fit_process(ProcessConfig(), more, targets)
    scales = np.asarray(process.hyperparameters.length_scales)[0]
    assert scales[3] > 3.0 * scales[:3].max()
    assert np.isfinite(predicted(process, more)[0]).all()


def with_nan(rows, row):
    rows = rows.copy()
    rows[row, 1] = np.nan
    return rows


X, Y = rows(20)


@pytest.mark.parametrize(
    ("inputs", "targets", "line"),
    [
        (X[:9], Y[:9], "got 9 rows, allowed: at least 10"),
        (with_nan(X, 4), Y, "got a value that is not finite in inputs row 4 (the first is 0), as in 1 rows in all"),
        (X, with_nan(Y, 0), "got a value that is not finite in targets row 0 (the first is 0)"),
        (X, Y[:12], "got inputs (20, 3) and targets (12, 2), allowed: as many rows of both"),
        (X[:, 0], Y, "got inputs (20,) and targets (20, 2)"),
    ],
    ids=["few", "inputs", "targets", "counts", "shape"],
)
def test_what_cannot_be_fitted_is_one_line(inputs, targets, line):
    with pytest.raises(ConfigError, match=f"^Gaussian process: {re.escape(line)}"):
        fit_process(ProcessConfig(), inputs, targets)
