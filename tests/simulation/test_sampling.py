import dataclasses
import shutil
import warnings

import numpy as np
import pytest
from arms import arm_named
from scipy.stats import qmc
from settled import ARM, settled_rows

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError
from qjrl.robot import bends_from_cables, robot_hash
from qjrl.simulation import sampling
from qjrl.simulation.sampling import SampleConfig, rows_done, sample_dataset, sample_rows
from qjrl.simulation.settle_problem import SettleConfig

SETTLE = SettleConfig(batch_size=8)
COLUMNS = {
    "cable_lengths": (4,),
    "pose": (9,),
    "bends": (2, 2),
    "strand_tension": (8,),
    "joint_positions": None,
    "equality_error": (),
    "speed": (),
    "converged": (),
    "seed": (),
}


def dataset(directory, num_samples, shard_size, seed=0, **options):
    sample_dataset(ARM, SETTLE, SampleConfig(num_samples, shard_size), seed, directory, **options)
    return artifacts.load(directory, robot_hash(ARM))


def assert_same_rows(one, other):
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """12 rows in shards of 8, uninterrupted."""
    return dataset(tmp_path_factory.mktemp("whole"), 12, 8)


def test_rows_do_not_depend_on_the_shards_or_the_pool(whole, tmp_path):
    assert_same_rows(dataset(tmp_path, 12, 4), whole)
    expected = {name: column[:12] for name, column in settled_rows().items()}
    assert_same_rows(whole, expected)  # settled 64 at once, in a pool of 256


def test_a_dataset_has_the_columns_of_its_format(whole):
    assert whole.keys() == COLUMNS.keys()
    for name, shape in COLUMNS.items():
        assert len(whole[name]) == 12
        if shape is not None:
            assert whole[name].shape[1:] == shape
    assert {whole[name].dtype for name in ("cable_lengths", "pose", "bends", "joint_positions")} == {np.dtype(float)}
    assert whole["converged"].dtype == bool and np.all(whole["seed"] == 0)


def test_commands_cover_the_disc_of_every_segment_by_a_sobol_sequence():
    lengths = sampling.sample_lengths(ARM, seed=0, start=0, count=64, home_share=0.0)
    bends = np.array([bends_from_cables(ARM, row) for row in lengths])
    radius = np.linalg.norm(bends, axis=2) / np.sin(float(ARM.bend_limit) / 2)
    turn = np.arctan2(bends[..., 1], bends[..., 0]) / (2 * np.pi) % 1.0
    numbers = np.stack([radius**2, turn], axis=2).reshape(len(bends), -1)
    np.testing.assert_allclose(numbers, qmc.Sobol(5, rng=0).random(64)[:, :4], atol=1e-9)
    for column in numbers.T:  # 64 points: one in each 64th of every dimension
        assert sorted(np.floor(64 * column).astype(int)) == list(range(64))


def test_a_share_of_the_rows_is_scaled_towards_home_and_the_others_are_not():
    even, mixed = (sampling.sample_lengths(ARM, 0, 0, 64, share) for share in (0.0, 0.25))
    bends = [np.array([bends_from_cables(ARM, row) for row in lengths]) for lengths in (even, mixed)]
    scales = [np.linalg.norm(one, axis=(1, 2)) for one in bends]
    ratio = scales[1] / scales[0]
    assert np.sum(ratio < 1.0 - 1e-9) == 16
    np.testing.assert_allclose(bends[1], ratio[:, None, None] * bends[0], atol=1e-12)
    np.testing.assert_allclose(np.sort(ratio)[:16], (np.arange(16) + 0.5) / 16, atol=0.5 / 16)


@pytest.mark.parametrize("when", ["between two shards", "inside a shard"])
def test_an_interruption_repeats_and_loses_no_row(whole, tmp_path, monkeypatch, when):
    real, calls = sampling.settle, []

    def settle(*args, **options):
        calls.append(0)
        if len(calls) == 2 and when == "inside a shard":
            raise KeyboardInterrupt
        return real(*args, **options)

    monkeypatch.setattr(sampling, "settle", settle)
    if when == "between two shards":
        dataset(tmp_path, 4, 4)
    else:
        with pytest.raises(KeyboardInterrupt):
            dataset(tmp_path, 12, 4)
    assert rows_done(tmp_path, robot_hash(ARM)) == 4
    assert_same_rows(dataset(tmp_path, 12, 4), whole)


def test_what_is_there_already_is_not_settled_again(whole, tmp_path):
    counted = []
    dataset(tmp_path, 8, 4, advance=counted.append)
    assert sum(counted) == 8
    dataset(tmp_path, 12, 8, advance=counted.append)
    assert sum(counted) == 12
    again = dataset(tmp_path, 12, 8, advance=counted.append)
    assert sum(counted) == 12
    assert_same_rows(again, whole)


def test_another_seed_gives_other_commands():
    first = sample_rows(ARM, SETTLE, seed=1, start=0, count=2)["cable_lengths"]
    assert not np.any(first == settled_rows()["cable_lengths"][:2])


@pytest.mark.parametrize(("start", "count"), [(0, 1), (0, 3), (0, 6), (5, 7), (64, 3)])
def test_any_number_of_rows_is_part_of_the_same_sequence_without_a_warning(start, count):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = sampling._sobol(4, 9, start, count)
    np.testing.assert_array_equal(found, qmc.Sobol(4, rng=9).random(128)[start : start + count])


def test_more_samples_than_fit_on_the_disk_are_one_line_and_nothing_is_written(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=100_000))
    with pytest.raises(
        ConfigError, match=r"^sample\.num_samples: got 5000, allowed: up to \d+, which fit on the disk$"
    ):
        dataset(tmp_path / "new", 5000, 8)
    assert not (tmp_path / "new").exists()


def test_more_samples_than_can_be_loaded_into_memory_are_one_line_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(sampling, "_memory", lambda: 1_000_000)
    message = r"^sample\.num_samples: got 99999999, allowed: up to \d{3}, which can be loaded into memory$"
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=10**15))
    with pytest.raises(ConfigError, match=message):
        dataset(tmp_path / "new", 99_999_999, 1024)
    with pytest.raises(ConfigError, match=message):
        sample_dataset(ARM, SETTLE, SampleConfig(99_999_999, 1024, shard=0), 0, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_row_has_the_same_bits_whatever_rows_come_with_it():
    alone = sample_rows(ARM, SETTLE, seed=0, start=5, count=1, home_share=SampleConfig.home_share)
    for name, column in settled_rows().items():
        np.testing.assert_array_equal(alone[name], column[5:6], err_msg=name)


def test_rows_on_the_disk_already_need_no_room(whole, tmp_path, monkeypatch):
    dataset(tmp_path, 12, 8)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=0))
    assert_same_rows(dataset(tmp_path, 12, 8), whole)
    with pytest.raises(ConfigError, match="allowed: up to 12, which fit on the disk"):
        dataset(tmp_path, 13, 8)


def test_a_row_takes_no_more_disk_than_is_reckoned_with(tmp_path, monkeypatch):
    dataset(tmp_path, 64, 64)
    size = sum(path.stat().st_size for path in tmp_path.iterdir())
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=size - 6000))  # less the files' frames
    with pytest.raises(ConfigError):
        dataset(tmp_path / "new", 64, 64)


def test_the_dataset_of_another_robot_is_refused(tmp_path):
    dataset(tmp_path, 1, 1)
    with pytest.raises(ArtifactError, match="belongs to another robot"):
        sample_dataset(arm_named("qj_2222"), SETTLE, SampleConfig(2, 1), 0, tmp_path)


def test_what_never_settles_is_kept_and_flagged(tmp_path):
    hurried = dataclasses.replace(SETTLE, max_time=0.1, hold_time=0.05)
    sample_dataset(ARM, hurried, SampleConfig(4, 4), 0, tmp_path)
    data = artifacts.load(tmp_path)
    assert len(data["seed"]) == 4 and not data["converged"].any()
