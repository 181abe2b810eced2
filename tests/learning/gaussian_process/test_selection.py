import numpy as np
import pytest
from processes import one_group, predict, predicted, rows, unscaled

from qjrl.config import ConfigError
from qjrl.learning.gaussian_process.addition import add_rows
from qjrl.learning.gaussian_process.fit import ProcessConfig, fit_process
from qjrl.learning.gaussian_process.selection import choose_inputs

POOL = rows(40, seed=7)[0]


@pytest.mark.parametrize("length_scales", ["shared", "own"])
def test_each_choice_is_the_most_uncertain_of_the_process_that_has_the_choices_before(length_scales):
    inputs, targets = rows(30)
    process, _ = fit_process(ProcessConfig(length_scales=length_scales), inputs, targets)
    chosen = choose_inputs(process, POOL, 4)
    assert len(set(chosen.tolist())) == 4
    for index in chosen:
        variance = np.sum(np.asarray(predict(process, POOL)[1]) / np.asarray(process.scaling.output_std) ** 2, axis=1)
        assert variance[index] == pytest.approx(variance.max(), rel=1e-9)
        process = add_rows(process, POOL[index : index + 1], np.zeros((1, 2)))  # whatever is measured


def test_a_row_is_chosen_once_and_chosen_ones_leave_less_uncertainty_than_the_first_of_the_pool():
    inputs, targets = rows(20)
    process = unscaled("squared_exponential", one_group(np.full(3, 1.5)), inputs, targets)
    assert sorted(choose_inputs(process, POOL, 40)) == list(range(40))
    chosen = choose_inputs(process, POOL, 6)
    left = [
        predicted(add_rows(process, POOL[index], np.zeros((6, 2))), POOL)[1].max() for index in (chosen, np.arange(6))
    ]
    assert left[0] < left[1]


@pytest.mark.parametrize("count", [0, 41])
def test_more_than_the_pool_holds_cannot_be_chosen(count):
    process = unscaled("matern_52", one_group(np.full(3, 1.5)), *rows(20))
    with pytest.raises(ConfigError, match=f"count: got {count} of a pool of 40 inputs, allowed: 1 to 40"):
        choose_inputs(process, POOL, count)
