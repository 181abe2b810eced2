import dataclasses

import jax
import numpy as np
import pytest

from qjrl.artifacts import ArtifactError, load
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.fitting import FitConfig, epoch_order, fit, member_seed, predict, predict_members
from qjrl.learning.networks import FourierResidualNetwork, NetworkConfig

CONFIG = FitConfig(epochs=6, batch_size=32, evaluate_every=2)
NETWORK = FourierResidualNetwork(
    NetworkConfig(width=16, num_blocks=1, num_frequencies=1, zero_output=False), output_size=2
)


def function(inputs):
    """Small numbers on a large offset, as poses in metres are."""
    return np.stack([5 + 1e-3 * np.sin(2 * inputs[:, 0]), 1e-3 * inputs[:, 0] * inputs[:, 1]], axis=1)


INPUTS = np.random.default_rng(0).uniform(-1, 1, (200, 2))
HELD_OUT = np.random.default_rng(1).uniform(-1, 1, (50, 2))
DATA = INPUTS, function(INPUTS)


def evaluate(predict):
    return {"error": float(np.abs(np.asarray(predict(HELD_OUT)) - function(HELD_OUT)).mean())}


@pytest.fixture(autouse=True, scope="module")
def _every_key_is_used_once():
    with jax.debug_key_reuse(True):
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted fit and its directory."""
    directory = tmp_path_factory.mktemp("whole")
    return fit(CONFIG, NETWORK, DATA, evaluate, "error", directory, seed=0), directory


def interrupted_after(calls):
    """An `evaluate` that breaks off like Ctrl-C, with the epochs since the last checkpoint lost."""
    done = []

    def evaluate_or_stop(predict):
        if len(done) == calls:
            raise KeyboardInterrupt
        done.append(0)
        return evaluate(predict)

    return evaluate_or_stop


def without_seconds(path):
    return [{name: value for name, value in line.items() if "seconds" not in name} for line in load(path)]


def assert_same_bits(one, other):
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(np.asarray(a), np.asarray(b)), one, other)


def test_a_known_function_is_learned(tmp_path):
    config = dataclasses.replace(CONFIG, epochs=100, evaluate_every=50)
    result = fit(config, NETWORK, DATA, evaluate, "error", tmp_path, seed=0)
    before = load(tmp_path / "progress.jsonl")[0]["error"]
    assert result.metrics["error"] < before / 10


def test_a_resumed_fit_equals_an_uninterrupted_one_bit_for_bit(whole, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        fit(CONFIG, NETWORK, DATA, interrupted_after(2), "error", tmp_path, seed=0)
    resumed = fit(CONFIG, NETWORK, DATA, evaluate, "error", tmp_path, seed=0)
    expected, directory = whole
    assert_same_bits(expected.fitted, resumed.fitted)
    assert (expected.epoch, expected.metrics) == (resumed.epoch, resumed.metrics)
    assert without_seconds(directory / "progress.jsonl") == without_seconds(tmp_path / "progress.jsonl")


def test_a_finished_fit_is_only_read_again(whole):
    first, directory = whole
    again = fit(CONFIG, NETWORK, DATA, interrupted_after(0), "error", directory, seed=0)
    assert_same_bits(first.fitted, again.fitted)


def test_nothing_of_a_fit_is_float64(whole):
    state = load(whole[1] / "checkpoints")["6"]
    dtypes = {leaf.dtype for leaf in jax.tree.leaves(state)}
    assert dtypes == {np.dtype(np.float32), np.dtype(np.int32), np.dtype(np.uint32)}


def test_every_member_of_an_ensemble_is_the_plain_fit_of_its_own_seed(tmp_path):
    """Up to the order of the sums of a batched product; the first member has the ensemble's seed."""
    last = dataclasses.replace(CONFIG, epochs=2)
    ensemble = fit(last, NETWORK, DATA, evaluate, "error", tmp_path / "all", seed=3, num_members=2).fitted
    plain = [
        fit(last, NETWORK, DATA, evaluate, "error", tmp_path / str(index), member_seed(3, index)).fitted
        for index in range(2)
    ]
    answers = np.asarray(predict_members(NETWORK, ensemble, HELD_OUT))
    assert member_seed(3, 0) == 3 and np.abs(answers[0] - answers[1]).max() > 1e-4
    for answer, one in zip(answers, plain, strict=True):
        np.testing.assert_allclose(answer, predict(NETWORK, one, HELD_OUT), atol=2e-6)
    np.testing.assert_allclose(predict(NETWORK, ensemble, HELD_OUT), answers.mean(axis=0), atol=1e-6)


def test_an_interrupted_ensemble_goes_on_as_if_it_had_not_been(tmp_path):
    once = fit(CONFIG, NETWORK, DATA, evaluate, "error", tmp_path / "once", seed=0, num_members=2)
    with pytest.raises(KeyboardInterrupt):
        fit(CONFIG, NETWORK, DATA, interrupted_after(2), "error", tmp_path / "twice", seed=0, num_members=2)
    again = fit(CONFIG, NETWORK, DATA, evaluate, "error", tmp_path / "twice", seed=0, num_members=2)
    assert_same_bits(once.fitted, again.fitted)


def test_the_best_checkpoint_is_the_one_returned(tmp_path):
    errors = iter([0.9, 0.2, 0.7, 0.5])  # of the epochs 0, 2, 4, 6
    result = fit(CONFIG, NETWORK, DATA, lambda predict: {"error": next(errors)}, "error", tmp_path, seed=0)
    assert (result.epoch, result.metrics) == (2, {"error": 0.2})
    lines = [(line["epoch"], line["error"]) for line in load(tmp_path / "progress.jsonl")]
    assert lines == [(0, 0.9), (2, 0.2), (4, 0.7), (6, 0.5)]


def test_an_untrained_zero_network_predicts_the_mean_of_the_targets(tmp_path):
    """And a column that never changes exactly: its standard deviation counts as 1, not 0."""
    targets = np.column_stack([INPUTS[:, 0], np.full(len(INPUTS), 3.0)])
    network = FourierResidualNetwork(NetworkConfig(width=8, num_blocks=0, zero_output=True), output_size=2)
    predictions = []

    def look_and_stop(predict):
        predictions.append(np.asarray(predict(HELD_OUT)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(CONFIG, network, (INPUTS, targets), look_and_stop, "error", tmp_path, seed=0)
    assert predictions[0] == pytest.approx(np.tile([INPUTS[:, 0].mean(), 3], (50, 1)), abs=1e-6)


def test_an_epoch_visits_each_row_at_most_once_in_an_order_of_its_own():
    key = jax.random.key(0)
    first, again, second = (np.asarray(epoch_order(key, epoch, 10, 3)) for epoch in (1, 1, 2))
    assert first.shape == (3, 3)
    assert len(set(first.ravel())) == 9
    assert np.array_equal(first, again)
    assert not np.array_equal(first, second)


def test_few_rows_make_one_batch():
    assert epoch_order(jax.random.key(0), 1, num_rows=5, batch_size=32).shape == (1, 5)


def test_targets_that_are_not_finite_stop_the_fit(tmp_path):
    broken = DATA[1].copy()
    broken[3, 0] = np.nan
    with pytest.raises(TrainingDiverged, match="training loss of epoch 1"):
        fit(CONFIG, NETWORK, (INPUTS, broken), lambda predict: {"error": 1.0}, "error", tmp_path, seed=0)


def test_the_directory_of_a_fit_on_other_data_is_refused(whole):
    with pytest.raises(ArtifactError, match="another configuration or data"):
        fit(CONFIG, NETWORK, (INPUTS, 2 * DATA[1]), evaluate, "error", whole[1], seed=0)


def test_inputs_without_targets_are_refused(tmp_path):
    with pytest.raises(ValueError, match="got 200 and 7 rows"):
        fit(CONFIG, NETWORK, (INPUTS, DATA[1][:7]), evaluate, "error", tmp_path, seed=0)
