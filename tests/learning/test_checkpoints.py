import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.artifacts import ArtifactError
from qjrl.learning.checkpoints import chosen, open_checkpoints, restore, restore_environment, rewind_log, save

STATE = {"weights": jnp.arange(3, dtype=jnp.float32), "key": jax.random.key(5), "count": jnp.int32(2)}


def saved_steps(directory, errors):
    with open_checkpoints(directory, "same", minimise="error") as checkpoints:
        for step, error in enumerate(errors):
            save(checkpoints, step, STATE, {"error": error})
        return list(checkpoints.all_steps()), checkpoints.best_step()


def test_the_best_and_the_latest_are_kept(tmp_path):
    assert saved_steps(tmp_path, [3.0, 1.0, 2.0, 4.0]) == ([1, 3], 1)


def test_a_metric_that_is_not_a_number_is_never_the_best(tmp_path):
    assert saved_steps(tmp_path, [float("nan"), 2.0, float("nan")]) == ([1, 2], 1)


def test_of_metrics_that_are_none_of_them_numbers_nothing_is_chosen(tmp_path):
    for values in ([float("nan")], [float("inf"), None, float("nan")]):
        with open_checkpoints(tmp_path / str(len(values)), "same", minimise="error") as checkpoints:
            for step, error in enumerate(values):
                save(checkpoints, step, STATE, {"error": error})
            assert checkpoints.best_step() is None
            with pytest.raises(ArtifactError, match="no checkpoint has a finite error"):
                chosen(checkpoints, "error")


def test_without_a_metric_the_latest_alone_is_kept(tmp_path):
    with open_checkpoints(tmp_path, "same") as checkpoints:
        for step in range(3):
            save(checkpoints, step, STATE)
        assert list(checkpoints.all_steps()) == [2]
        assert checkpoints.best_step() == 2


def test_a_state_comes_back_bit_for_bit(tmp_path):
    with open_checkpoints(tmp_path, "same") as checkpoints:
        save(checkpoints, 0, STATE)
    with open_checkpoints(tmp_path, "same") as checkpoints:
        restored = restore(checkpoints, 0, STATE)
    assert np.array_equal(restored["weights"], STATE["weights"])
    assert jax.random.uniform(restored["key"]) == jax.random.uniform(STATE["key"])
    assert restored["count"].dtype == jnp.int32


def test_environment_arrays_of_any_kind_come_back(tmp_path):
    arrays = {
        "state/positions": np.random.default_rng(0).random((4, 3)),
        "random": np.array([2**64 - 1, 3], np.uint64),
        "flags": np.array([True, False]),
        "none": np.zeros((0, 2)),
        "count": np.int64(7),
    }
    with open_checkpoints(tmp_path, "same") as checkpoints:
        save(checkpoints, 0, STATE, environment=arrays)
        restored = restore_environment(checkpoints, 0)
    assert restored.keys() == arrays.keys()
    for name, array in arrays.items():
        assert np.array_equal(restored[name], array)
        assert restored[name].dtype == array.dtype


def test_the_directory_of_another_training_is_refused(tmp_path):
    with open_checkpoints(tmp_path, "same"):
        pass
    with pytest.raises(ArtifactError, match="another configuration or data"):
        open_checkpoints(tmp_path, "other")


def test_a_log_is_cut_back_to_its_checkpoint(tmp_path):
    path = tmp_path / "progress.jsonl"
    lines = [json.dumps({"epoch": epoch}) for epoch in range(4)]
    path.write_text("\n".join([*lines, '{"epoch": 4, "lo']))
    assert rewind_log(path, "epoch", 2) == [{"epoch": 0}, {"epoch": 1}, {"epoch": 2}]
    assert path.read_text() == "".join(line + "\n" for line in lines[:3])


def test_half_a_line_left_by_a_crash_is_dropped(tmp_path):
    path = tmp_path / "progress.jsonl"
    path.write_text('{"epoch": 0}\n{"epo')
    assert rewind_log(path, "epoch", 5) == [{"epoch": 0}]
