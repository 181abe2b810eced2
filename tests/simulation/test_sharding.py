"""Parts of a data set made by many processes become that of one process, and what is wrong with them is one line."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from arms import arm_named
from killed_sampling import SHARDS_PER_KILL
from settled import ARM, settled_rows

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, build
from qjrl.robot import robot_hash
from qjrl.simulation import sampling
from qjrl.simulation.sampling import SampleConfig, check_placed, num_rows, part_ranges, row_settings, sample_dataset
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.sharding import join_parts

SETTLE = SettleConfig()
ROOT = Path(__file__).parent.parent.parent


@pytest.fixture
def settled_before(monkeypatch):
    """Rows come from those settled once for all tests; counts how many are asked for."""
    counts = []

    def rows(robot, simulation, seed, start, count, advance=None, home_share=0.0):
        counts.append(count)
        return {name: column[start : start + count] for name, column in settled_rows().items()}

    monkeypatch.setattr(sampling, "sample_rows", rows)
    return counts


def make_part(parts, shard, num_shards, num_samples=24, shard_size=3, seed=0, robot=ARM, simulation=SETTLE):
    sample = SampleConfig(num_samples, shard_size, shard, num_shards)
    sample_dataset(robot, simulation, sample, seed, parts / f"{shard}-of-{num_shards}")


def join(parts, num_samples=24, simulation=SETTLE):
    out = parts.with_name("dataset")
    join_parts(parts, out, robot_hash(ARM), row_settings(simulation, SampleConfig.home_share, 0), num_samples)
    return artifacts.load(out, robot_hash(ARM))


def assert_rows_of_one_process(data, count):
    for name, column in settled_rows().items():
        np.testing.assert_array_equal(data[name], column[:count], err_msg=name)


@pytest.mark.parametrize("num_samples", [4, 5, 23, 24, 25, 100, 1023])
@pytest.mark.parametrize(("shard_size", "num_shards"), [(1, 1), (3, 4), (1024, 4), (7, 3)])
def test_the_parts_share_every_row_once_and_evenly(num_samples, shard_size, num_shards):
    samples = [SampleConfig(num_samples, shard_size, shard, num_shards) for shard in range(num_shards)]
    files = sorted(file for sample in samples for file in part_ranges(sample))
    rows = [row for first, count in files for row in range(first, first + count)]
    assert rows == list(range(num_samples))
    assert max(count for _, count in files) <= shard_size
    sizes = [num_rows(sample) for sample in samples]
    assert min(sizes) > 0 and max(sizes) - min(sizes) <= len(files) // num_shards


def test_parts_settled_alone_are_bitwise_the_rows_of_one_process(tmp_path):
    for shard in (1, 0):
        make_part(tmp_path / "parts", shard, 2, num_samples=8)
    assert_rows_of_one_process(join(tmp_path / "parts", 8), 8)


@pytest.mark.parametrize("num_shards", [1, 3, 4])
def test_the_joined_data_set_is_that_of_one_process_in_order(tmp_path, settled_before, num_shards):
    for shard in reversed(range(num_shards)):
        make_part(tmp_path / "parts", shard, num_shards)
    assert sum(settled_before) == 24
    assert_rows_of_one_process(join(tmp_path / "parts"), 24)
    listed = artifacts.read_manifest(tmp_path / "dataset")["shards"]
    assert [shard["name"] for shard in listed] == [f"shard-{i:05d}.npz" for i in range(len(listed))]
    assert sorted(path.name for path in (tmp_path / "dataset").iterdir()) == ["manifest.json"] + [
        shard["name"] for shard in listed
    ]
    assert_rows_of_one_process(join(tmp_path / "parts"), 24)  # killed before the parts were deleted: once more


def test_an_interrupted_part_settles_only_what_is_missing(tmp_path, settled_before):
    make_part(tmp_path / "parts", 0, 2)
    manifest = artifacts.read_manifest(tmp_path / "parts" / "0-of-2")
    del manifest["shards"][2:]
    artifacts.write_json(tmp_path / "parts" / "0-of-2" / "manifest.json", manifest)
    settled_before.clear()
    make_part(tmp_path / "parts", 0, 2)
    assert settled_before == [3, 3]
    make_part(tmp_path / "parts", 1, 2)
    assert_rows_of_one_process(join(tmp_path / "parts"), 24)


def test_missing_rows_are_named(tmp_path, settled_before):
    make_part(tmp_path / "parts", 1, 4)
    message = r"parts: rows 0 to 2, rows 6 to 14, rows 18 to 23 of 24 are missing; the same sample\.shard="
    with pytest.raises(ArtifactError, match=message):
        join(tmp_path / "parts")
    assert not (tmp_path / "dataset").exists()


def test_rows_that_are_there_twice_are_named(tmp_path, settled_before):
    for shard, num_shards in [(0, 2), (1, 2), (0, 4)]:
        make_part(tmp_path / "parts", shard, num_shards)
    message = r"rows 0 to 2 are there twice, in 0-of-2/shard-00000.npz and 0-of-4/shard-00000.npz; delete one"
    with pytest.raises(ArtifactError, match=message):
        join(tmp_path / "parts")


def test_parts_of_more_rows_than_asked_for_are_named(tmp_path, settled_before):
    make_part(tmp_path / "parts", 0, 1)
    with pytest.raises(ArtifactError, match=r"0-of-1 has rows 21 to 23, but sample\.num_samples is 22 here"):
        join(tmp_path / "parts", 22)


def test_a_part_of_other_settings_is_named_with_what_differs(tmp_path, settled_before):
    make_part(tmp_path / "parts", 0, 2)
    make_part(tmp_path / "parts", 1, 2, seed=7, simulation=SettleConfig(timestep=0.002))
    message = r"1-of-2: was made with another configuration: seed is 7 there and 0 here, simulation\.timestep is 0\.002"
    with pytest.raises(ArtifactError, match=message):
        join(tmp_path / "parts")
    with pytest.raises(ArtifactError, match=r"1-of-2: holds rows of other settings: seed is 7 there and 0 here"):
        make_part(tmp_path / "parts", 1, 2, simulation=SettleConfig(timestep=0.002))


def test_threads_and_batches_may_differ_between_machines(tmp_path, settled_before):
    make_part(tmp_path / "parts", 0, 2)
    make_part(tmp_path / "parts", 1, 2, simulation=SettleConfig(batch_size=8, num_threads=1))
    assert_rows_of_one_process(join(tmp_path / "parts"), 24)


def test_a_part_of_another_robot_is_named(tmp_path, settled_before):
    make_part(tmp_path / "parts", 0, 2)
    make_part(tmp_path / "parts", 1, 2, robot=arm_named("qj_2222"))
    with pytest.raises(ArtifactError, match=r"1-of-2.*: belongs to another robot"):
        join(tmp_path / "parts")


@pytest.mark.parametrize("harm", ["truncated", "missing"])
def test_a_damaged_file_is_named_and_the_old_data_set_stays(tmp_path, settled_before, harm):
    make_part(tmp_path / "parts", 0, 1)
    join(tmp_path / "parts")
    victim = tmp_path / "parts" / "0-of-1" / "shard-00003.npz"
    content = victim.read_bytes()
    victim.unlink()
    if harm == "truncated":
        victim.write_bytes(content[:-1])
    with pytest.raises(ArtifactError, match=r"0-of-1/shard-00003.npz: is missing or damaged"):
        join(tmp_path / "parts")
    assert_rows_of_one_process(artifacts.load(tmp_path / "dataset"), 24)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"shard": 4}, r"^sample\.shard: got 4, allowed: below num_shards = 4$"),
        ({"shard": -1}, r"^sample\.shard: got -1, allowed: an integer from 0 to 9999 or null$"),
        ({"shard": 1, "num_samples": 3}, r"^sample\.num_shards: got 4, allowed: up to num_samples = 3$"),
    ],
)
def test_a_part_that_there_is_not_is_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        build(SampleConfig, values, "sample")


def assert_kills_leave_the_uninterrupted_data_set(folder, kills):
    program = [sys.executable, str(Path(__file__).with_name("killed_sampling.py")), str(folder), str(kills)]
    said = subprocess.run(program, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    assert said.stdout.count("killed") > 0.5 * kills  # the others came after its end
    whole, killed = (
        {path.name: path.read_bytes() for path in (folder / name).iterdir()} for name in ("whole", "killed")
    )
    assert len(whole) == 1 + SHARDS_PER_KILL * kills
    assert killed == whole
    assert artifacts.load(folder / "killed", robot_hash(ARM))["converged"].all()


def test_10_kills_at_random_moments_lose_nothing(tmp_path):
    assert_kills_leave_the_uninterrupted_data_set(tmp_path, 10)


@pytest.mark.slow
def test_100_kills_at_random_moments_lose_nothing(tmp_path):
    assert_kills_leave_the_uninterrupted_data_set(tmp_path, 100)


def test_a_manifest_that_does_not_say_which_rows_it_holds_is_one_line(tmp_path):
    manifest = {"shards": [{"name": "shard-00000.npz", "rows": 4, "sha256": ""}], "settings": {}}
    with pytest.raises(ArtifactError, match=r"manifest\.json: .*first_row is missing"):
        check_placed(tmp_path, manifest)
    manifest["shards"][0]["first_row"] = 0
    check_placed(tmp_path, manifest)
    del manifest["settings"]
    with pytest.raises(ArtifactError, match="settings is missing"):
        check_placed(tmp_path, manifest)
