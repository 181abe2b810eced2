import numpy as np
import pytest
from processes import one_group, predicted, rows, unscaled

from qjrl.config import ConfigError
from qjrl.learning.gaussian_process.addition import add_rows
from qjrl.learning.gaussian_process.fit import ProcessConfig, fit_process
from qjrl.learning.gaussian_process.kernels import KERNELS
from qjrl.learning.gaussian_process.posterior import condition

SCALES = np.array([1.4, 0.8, 2.5])


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("blocks", [(30,), (1, 1, 28), (10, 20)], ids=str)
def test_rows_added_in_blocks_give_the_process_of_all_rows(kernel, blocks):
    inputs, targets = rows(90)
    process = unscaled(kernel, one_group(SCALES), inputs[:60], targets[:60])
    done = 60
    for block in blocks:
        process = add_rows(process, inputs[done : done + block], targets[done : done + block])
        done += block
    fresh = unscaled(kernel, one_group(SCALES), inputs, targets)
    np.testing.assert_allclose(process.cholesky, fresh.cholesky, atol=1e-10)
    np.testing.assert_allclose(process.weights, fresh.weights, atol=1e-10)
    for ours, other in zip(predicted(process, inputs + 0.1), predicted(fresh, inputs + 0.1), strict=True):
        np.testing.assert_allclose(ours, other, atol=1e-10)


def test_a_fitted_process_keeps_scaling_and_hyperparameters_of_every_group():
    inputs, targets = rows(60)
    process, _ = fit_process(ProcessConfig(length_scales="own"), inputs[:50], targets[:50])
    grown = add_rows(process, inputs[50:], targets[50:])
    fresh = condition(process.kernel, process.hyperparameters, process.scaling, inputs, targets)
    np.testing.assert_allclose(grown.cholesky, fresh.cholesky, atol=1e-10)
    np.testing.assert_allclose(predicted(grown, inputs)[0], predicted(fresh, inputs)[0], atol=1e-9)


def test_a_row_that_is_not_finite_is_refused():
    inputs, targets = rows(20)
    process = unscaled("matern_52", one_group(SCALES), inputs, targets)
    with pytest.raises(ConfigError, match="not finite in targets row 0"):
        add_rows(process, inputs[:1], np.full((1, 2), np.inf))
