import json
import os
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qjrl import artifacts, plain_json
from qjrl.artifacts import ArtifactError


def refused(path, **options) -> str:
    with pytest.raises(ArtifactError) as caught:
        artifacts.load(path, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def rows(start: int, count: int) -> dict[str, np.ndarray]:
    return {"pose": np.arange(start, start + count)[:, None] * np.ones(9), "converged": np.ones(count, bool)}


def test_arrays_come_back_bit_for_bit(tmp_path) -> None:
    arrays = {"a": np.random.default_rng(0).normal(size=(3, 2)).astype(np.float32), "names": np.array(["x", "y"])}
    artifacts.write_arrays(tmp_path / "a.npz", arrays)
    loaded = artifacts.load(tmp_path / "a.npz")
    assert loaded.keys() == arrays.keys()
    assert all(np.array_equal(loaded[key], arrays[key]) and loaded[key].dtype == arrays[key].dtype for key in arrays)


def test_objects_are_refused_because_they_would_be_pickled(tmp_path) -> None:
    with pytest.raises(ArtifactError, match="pickle"):
        artifacts.write_arrays(tmp_path / "a.npz", {"a": np.array([{}])})
    np.savez(tmp_path / "b.npz", a=np.array([{}]))
    assert "b.npz" in refused(tmp_path / "b.npz")


def test_json_and_json_lines_come_back(tmp_path) -> None:
    artifacts.write_json(tmp_path / "a.json", {"x": np.float32(0.5), "y": np.arange(2), "z": (1, tmp_path / "f")})
    assert artifacts.load(tmp_path / "a.json") == {"x": 0.5, "y": [0, 1], "z": [1, str(tmp_path / "f")]}
    artifacts.append_json_line(tmp_path / "new" / "a.jsonl", {"step": 1})
    artifacts.append_json_line(tmp_path / "new" / "a.jsonl", {"step": 2})
    assert artifacts.load(tmp_path / "new" / "a.jsonl") == [{"step": 1}, {"step": 2}]


def test_a_line_torn_by_a_crash_is_cut_off_by_the_next_one(tmp_path) -> None:
    path = tmp_path / "progress.jsonl"
    for torn in ('{"step": 1}\n{"ste', '{"ste'):
        path.write_text(torn)
        refused(path)
        artifacts.append_json_line(path, {"step": 2})
        assert artifacts.load(path)[-1] == {"step": 2}
        assert len(artifacts.load(path)) == torn.count("\n") + 1


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch) -> None:
    artifacts.write_json(tmp_path / "a.json", 1)

    def full_disk(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match="no space"):
        artifacts.write_json(tmp_path / "a.json", 2)
    assert artifacts.load(tmp_path / "a.json") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize("name", ["a.npz", "a.json"])
def test_a_file_truncated_anywhere_is_refused(tmp_path, name) -> None:
    path = tmp_path / name
    if name == "a.npz":
        artifacts.write_arrays(path, rows(0, 50))
    else:
        artifacts.write_json(path, {"x": list(range(50))})
    whole = path.read_bytes()
    for kept in (0, 1, len(whole) // 2, len(whole) - 2):
        path.write_bytes(whole[:kept])
        assert name in refused(path)


def test_a_missing_or_foreign_file_is_refused(tmp_path) -> None:
    assert "does not exist" in refused(tmp_path / "no.npz")
    (tmp_path / "a.npz").write_text("hello")
    assert "not a .npz file" in refused(tmp_path / "a.npz")
    (tmp_path / "a.pkl").write_bytes(b"")
    assert "unknown kind" in refused(tmp_path / "a.pkl")


def test_a_dataset_is_its_shards_one_after_the_other(tmp_path) -> None:
    artifacts.append_shard(tmp_path / "dataset", rows(0, 3), "robot", seed=1)
    artifacts.append_shard(tmp_path / "dataset", rows(3, 2), "robot", seed=1)
    loaded = artifacts.load(tmp_path / "dataset", robot_hash="robot")
    assert np.array_equal(loaded["pose"], rows(0, 5)["pose"])
    manifest = json.loads((tmp_path / "dataset" / "manifest.json").read_text())
    assert manifest["format"] == 1 and manifest["seed"] == 1 and manifest["robot_hash"] == "robot"
    assert [(shard["name"], shard["rows"]) for shard in manifest["shards"]] == [
        ("shard-00000.npz", 3),
        ("shard-00001.npz", 2),
    ]


def test_a_shard_without_its_entry_in_the_manifest_is_written_again(tmp_path) -> None:
    artifacts.append_shard(tmp_path, rows(0, 3), "robot")
    artifacts.write_arrays(tmp_path / "shard-00001.npz", rows(90, 7))  # interrupted before the manifest
    assert len(artifacts.load(tmp_path)["pose"]) == 3
    artifacts.append_shard(tmp_path, rows(3, 2), "robot")
    assert np.array_equal(artifacts.load(tmp_path)["pose"], rows(0, 5)["pose"])


def test_a_dataset_that_is_not_what_its_manifest_says_is_refused(tmp_path) -> None:
    artifacts.append_shard(tmp_path, rows(0, 3), "robot")
    assert "another robot" in refused(tmp_path, robot_hash="other")
    artifacts.write_arrays(tmp_path / "shard-00000.npz", rows(1, 3))
    assert "sha256" in refused(tmp_path)
    artifacts.write_arrays(tmp_path / "shard-00000.npz", rows(0, 4))
    assert "4" in refused(tmp_path) and "3" in refused(tmp_path)
    (tmp_path / "shard-00000.npz").unlink()
    assert "does not exist" in refused(tmp_path)
    artifacts.write_json(tmp_path / "manifest.json", {"format": 2, "shards": []})
    assert "format 1" in refused(tmp_path)


def test_any_other_directory_is_a_dict_of_its_files(tmp_path) -> None:
    artifacts.write_json(tmp_path / "metrics.json", {"a": 1})
    artifacts.write_arrays(tmp_path / "more" / "parameters.npz", {"w": np.ones(2)})
    (tmp_path / "report.html").write_text("x")
    loaded = artifacts.load(tmp_path)
    assert loaded.keys() == {"metrics.json", "more"} and loaded["metrics.json"] == {"a": 1}
    assert np.array_equal(loaded["more"]["parameters.npz"]["w"], np.ones(2))


def test_an_orbax_checkpoint_comes_back_as_host_arrays(tmp_path) -> None:
    import jax.numpy as jnp
    import orbax.checkpoint as ocp

    state = {"w": jnp.arange(3, dtype=jnp.float32), "step": jnp.int32(4)}
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save(tmp_path / "state", state)
    loaded = artifacts.load(tmp_path / "state")
    assert type(loaded["w"]) is np.ndarray and loaded["w"].tolist() == [0, 1, 2] and loaded["step"] == 4


short = st.text(max_size=8)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | short,
    lambda x: st.lists(x, max_size=4) | st.dictionaries(short, x, max_size=4),
    max_leaves=8,
)


@given(st.dictionaries(short, json_values, max_size=6))
def test_the_hash_does_not_depend_on_the_order_of_keys(content) -> None:
    assert artifacts.hash_of(content) == artifacts.hash_of(dict(reversed(content.items())))
    assert artifacts.hash_of(content) != artifacts.hash_of({**content, "one more": 1})


def test_the_hash_of_a_directory_sees_names_and_bytes_but_not_provenance(tmp_path) -> None:
    artifacts.write_json(tmp_path / "a.json", 1)
    first = artifacts.hash_of_directory(tmp_path)
    artifacts.write_json(tmp_path / artifacts.PROVENANCE, {"hardware": "x"})
    artifacts.mark_done(tmp_path, config_hash="c")
    assert artifacts.hash_of_directory(tmp_path) == first
    assert artifacts.done_marker(tmp_path) == {"config_hash": "c", "output_hash": first}
    artifacts.write_json(tmp_path / "a.json", 2)
    assert artifacts.hash_of_directory(tmp_path) != first


@pytest.mark.parametrize("number", [float("nan"), float("inf"), np.float32("-inf"), np.array([1.0, np.nan])])
def test_json_holds_no_number_that_json_lacks(tmp_path, number) -> None:
    artifacts.write_json(tmp_path / "a.json", {"x": number, "y": [1.5, number]})
    artifacts.append_json_line(tmp_path / "a.jsonl", {"x": number})
    for path in (tmp_path / "a.json", tmp_path / "a.jsonl"):
        json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(name))
    found = artifacts.load(tmp_path / "a.json")["x"]
    np.testing.assert_array_equal(plain_json.numbers_again(found), np.where(np.isfinite(number), number, np.nan))


def test_files_of_before_with_a_bare_nan_are_still_read(tmp_path) -> None:
    (tmp_path / "a.json").write_text('{"x": NaN}')
    assert np.isnan(artifacts.load(tmp_path / "a.json")["x"])


@pytest.mark.parametrize("content", ["[]", "3", '{"a": "x"}', '{"a": true}', '{"b": 1}'])
def test_a_record_without_what_is_asked_of_it_is_refused(tmp_path, content) -> None:
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(ArtifactError, match=r"a\.json: is not a record"):
        artifacts.read_record(tmp_path / "a.json", {"a": int}, "a record")


def test_a_manifest_names_files_beside_it_only(tmp_path) -> None:
    artifacts.append_shard(tmp_path / "data", rows(0, 3), "robot")
    manifest = artifacts.load(tmp_path / "data" / "manifest.json")
    for entry in ({"name": "../x.npz"}, {"name": 3}, {"rows": "3"}, {"sha256": None}):
        artifacts.write_json(
            tmp_path / "data" / "manifest.json", manifest | {"shards": [manifest["shards"][0] | entry]}
        )
        assert "manifest.json" in refused(tmp_path / "data")


def test_columns_are_checked_by_name_and_length_where_they_are_read(tmp_path) -> None:
    path = tmp_path / "held_out.npz"
    artifacts.write_arrays(path, {"a": np.zeros(3), "b": np.zeros((3, 2)), "other": np.zeros(1)})
    assert artifacts.load_columns(path, ("a", "b"), "what a stage writes").keys() == {"a", "b", "other"}
    with pytest.raises(ArtifactError, match=r"held_out\.npz: is not what a stage writes \(c is missing\)"):
        artifacts.load_columns(path, ("a", "c"), "what a stage writes")
    with pytest.raises(ArtifactError, match="different numbers of rows"):
        artifacts.load_columns(path, ("a", "other"), "what a stage writes")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a", "a text")
    with pytest.raises(ArtifactError, match="a is no array"):
        artifacts.load_columns(path, ("a",), "what a stage writes")
