import json
import math
import random

import pytest

from qjrl.artifacts import ArtifactError
from qjrl.measured import read_metrics, read_progress
from qjrl.records import NUMBER, Kinds, check_record, holds_numbers

KINDS: Kinds = {"form": str, "steps": int, "held_out": {"median_mm": NUMBER, "by": {"set": NUMBER}}}
WHOLE = {"form": "x", "steps": 3, "held_out": {"median_mm": None, "by": {"set": 0.5}}, "more": [1]}
OF_ANOTHER_TYPE = (True, [], [1.0], {}, {"a": 1}, "1", None, 1.5)


def places(kinds: Kinds, above: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], object]]:
    """Every key that is asked for, with those above it, and what is allowed there."""
    found = []
    for key, kind in kinds.items():
        found.append(((*above, key), kind))
        found += places(kind, (*above, key)) if isinstance(kind, dict) else []
    return found


def changed(where: tuple[str, ...], change) -> dict:
    content = json.loads(json.dumps(WHOLE))
    holder = content
    for key in where[:-1]:
        holder = holder[key]
    change(holder, where[-1])
    return content


def test_what_is_whole_is_read_with_nan_for_null(tmp_path) -> None:
    (tmp_path / "metrics.json").write_text(json.dumps(WHOLE))
    found = read_metrics(tmp_path / "metrics.json", KINDS)
    assert math.isnan(found["held_out"].pop("median_mm"))
    assert found == {"form": "x", "steps": 3, "held_out": {"by": {"set": 0.5}}, "more": [1]}


@pytest.mark.parametrize(("where", "kind"), places(KINDS), ids=str)
def test_a_key_that_is_gone_or_of_another_type_is_one_line_that_names_it(tmp_path, where, kind) -> None:
    path = tmp_path / "metrics.json"
    wrong = [value for value in OF_ANOTHER_TYPE if value is True or not isinstance(value, _type(kind))]
    contents = [changed(where, lambda holder, key, value=value: holder.update({key: value})) for value in wrong]
    for content in [*contents, changed(where, lambda holder, key: holder.pop(key))]:
        path.write_text(json.dumps(content))
        with pytest.raises(ArtifactError) as error:
            read_metrics(path, KINDS)
        assert str(error.value).startswith(f"{path}: is not a file of measured numbers ({'.'.join(where)} is ")
        assert "\n" not in str(error.value)


def _type(kind):
    return dict if isinstance(kind, dict) else kind


@pytest.mark.parametrize(
    "content", ["", "\n", "[]\n", "3\n", '{"epoch": 1}\n[]\n', '{"epoch": "x"}\n', '{"step": 1}\n']
)
def test_a_log_that_holds_no_records_of_numbers_is_one_line(tmp_path, content) -> None:
    (tmp_path / "progress.jsonl").write_text(content)
    with pytest.raises(ArtifactError, match=r"progress\.jsonl"):
        read_progress(tmp_path / "progress.jsonl", "epoch")


def test_random_records_are_read_or_refused_as_a_mapping_of_numbers_is(tmp_path) -> None:
    draw, codes = random.Random(3), set()
    values = (1, 0.5, None, -3, True, "x", [], {})
    for _ in range(200):
        keys = draw.sample(["epoch", "loss", "p99_mm"], draw.randrange(4))
        record = {key: draw.choice(values[: draw.choice([4, 4, 8])]) for key in keys}
        (tmp_path / "progress.jsonl").write_text(json.dumps({"epoch": 0}) + "\n" + json.dumps(record) + "\n")
        expected = holds_numbers(record) and "epoch" in record
        assert holds_numbers(record) == all(type(value) in (int, float, type(None)) for value in record.values())
        try:
            assert len(read_progress(tmp_path / "progress.jsonl", "epoch")) == 2
            assert expected
        except ArtifactError as error:
            assert not expected
            assert ", line 2: " in str(error)
        codes.add(expected)
    assert codes == {True, False}


def test_what_is_no_mapping_is_no_record() -> None:
    for content in (None, 3, "x", [], [{}]):
        with pytest.raises(ArtifactError, match="holds no mapping"):
            check_record("x.json", content, {}, "a record")
