"""Output that makes room is never deleted, and is taken back when it is wanted again."""

import itertools
import random
import shutil

import pytest
from test_pipeline import calls, run, run_shared, shared  # noqa: F401

from qjrl import artifacts, kept


def contents(run_dir, name="one") -> set[int]:
    """What all finished outputs of a stage hold, wherever they lie."""
    found = [path for path in run_dir.glob(f"{name}*") if (path / "done.json").exists()]
    return {artifacts.load(path / "count.json") for path in found}


def test_the_third_run_finds_the_first_s_output_again(tmp_path, calls) -> None:  # noqa: F811
    for count in (8, 9, 8):
        run(tmp_path, first={"count": count})
    assert calls == ["first", "second"] * 2
    assert artifacts.load(tmp_path / "one" / "count.json") == 8
    assert artifacts.load(tmp_path / "two" / "product.json") == 8
    assert artifacts.load(tmp_path / "one.previous" / "count.json") == 9


def test_nothing_finished_is_ever_lost_or_made_twice(tmp_path, calls) -> None:  # noqa: F811
    draw, seen = random.Random(3), set()
    for _ in range(30):
        count = draw.choice([1, 2, 3, 4, 5, 6])
        run(tmp_path, stages=["first"], first={"count": count})
        seen.add(count)
        assert artifacts.load(tmp_path / "one" / "count.json") == count
        assert contents(tmp_path) == seen
    assert len(calls) == len(seen)


def test_work_that_was_begun_goes_on_when_it_is_wanted_again(tmp_path, calls) -> None:  # noqa: F811
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stages=["first"], first={"count": 7})
    run(tmp_path, stages=["first"], first={"count": 8})
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stages=["first"], first={"count": 7})
    assert calls == ["first", "first", "first, going on"]


def test_damaged_output_that_is_kept_stops_nobody(tmp_path, calls) -> None:  # noqa: F811
    for count in (8, 9):
        run(tmp_path, stages=["first"], first={"count": count})
    for number, text in enumerate(("{}", "{", "[]", '{"output_hash": 3}')):
        (tmp_path / "one.previous" / "done.json").write_text(text)
        (tmp_path / "one.previous" / "provenance.json").write_text(text)
        shutil.copytree(tmp_path / "one.previous", tmp_path / f"one.previous-{number + 10}")
    run(tmp_path, stages=["first"], first={"count": 8})
    assert calls == ["first"] * 3


@pytest.mark.parametrize("text", ["{}", "{", "[]", '{"output_hash": 3}', ""])
@pytest.mark.parametrize("name", ["done.json", "provenance.json"])
def test_a_record_that_somebody_made_by_hand_is_one_line(tmp_path, calls, name, text) -> None:  # noqa: F811
    run(tmp_path, stages=["first"])
    if name == "provenance.json":
        (tmp_path / "one" / "done.json").unlink()
    (tmp_path / "one" / name).write_text(text)
    with pytest.raises(artifacts.ArtifactError, match=name) as error:
        run(tmp_path)
    assert "\n" not in str(error.value)


def test_a_whole_that_made_room_is_taken_back_by_any_part(tmp_path, shared) -> None:  # noqa: F811
    for seed in (1, 2):
        for share in (0, 1):
            run_shared(tmp_path, share, ["first"], seed=seed)
    count = len(shared)
    run_shared(tmp_path, 1, ["first"], seed=1)
    assert len(shared) == count
    assert artifacts.load(tmp_path / "one" / "count.json") == 3


def test_the_latest_comes_first_and_other_names_are_none(tmp_path) -> None:
    for number in itertools.count(1):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / str(number)).touch()
        kept.move_away(tmp_path / "out")
        if number == 12:
            break
    (tmp_path / "out.previous-x").mkdir()
    (tmp_path / "other.previous").mkdir()
    (tmp_path / "out.previous-99").touch()
    found = [next(path.iterdir()).name for path in kept.kept_of(tmp_path / "out")]
    assert found == [str(number) for number in range(12, 0, -1)]
