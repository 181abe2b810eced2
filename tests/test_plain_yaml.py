"""One YAML means what an engineer means by it, wherever it is read."""

import json

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from omegaconf._utils import get_yaml_loader

from qjrl import plain_yaml
from qjrl.config import conf_folder, read_yaml

LAUGHS = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{letter}: &{letter} [{','.join(['*' + before] * 10)}]\n" for before, letter in zip("abcde", "bcdef", strict=True)
)
"""A million values in seven lines."""


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *[("065", 65), ("022", 22), ("+08", 8), ("-0", 0), ("1:30", "1:30"), ("0o17", "0o17"), ("0x1F", "0x1F")],
        *[("1_000", "1_000"), ("yes", "yes"), ("No", "No"), ("on", "on"), ("OFF", "OFF"), ("y", "y"), ("=", "=")],
        *[("2024-05-01", "2024-05-01"), ("true", True), ("False", False), ("~", None), ("", None), ("null", None)],
        *[("1e-3", 1e-3), ("2E5", 2e5), (".5", 0.5), ("5.", 5.0), ("065.5", 65.5), ("-.inf", float("-inf"))],
        *[("'065'", "065"), ("1.2.3", "1.2.3"), ("e5", "e5"), ("1e", "1e"), ("0b11", "0b11")],
    ],
)
def test_a_scalar_is_read_in_decimals_and_without_yaml_1_1(text, value) -> None:
    found = plain_yaml.load(f"a: {text}")["a"]
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3", r"^line 3: the key 'a' stands twice"),
        ("a: {b: 1,\n b: 1}", r"^line 2: the key 'b' stands twice"),
        ("1: x", r"^line 1: a key must be a text, got 1"),
        ("a: !!python/name:os.system", r"^line 1: could not determine a constructor"),
        ("a: !!int 0x1F", r"^line 1: '0x1F' cannot be read as int"),
        ("a: !!timestamp 2024-05-01", r"^line 1: could not determine a constructor"),
        ("a: &a [*a]", "nested deeper"),
        ("[" * 5000, "nested too deeply"),
        (LAUGHS, "more than 100000"),
        ("a: 1\n---\nb: 2", r"^line 2: but found another document"),
        ("a: \0", "special characters"),
        ("a: " + "1" * 5000, "cannot be read as int"),
    ],
    ids=range(12),
)  # fmt: skip
def test_what_has_no_plain_meaning_is_one_line(text, message) -> None:
    with pytest.raises(plain_yaml.NotPlain, match=message) as error:
        plain_yaml.load(text)
    assert "\n" not in str(error.value)


def test_anchors_and_merges_mean_what_they_mean_in_yaml() -> None:
    assert plain_yaml.load("a: &x {b: 1, c: 2}\nd: {<<: *x, b: 3}\ne: {<<: *x}")["d"] == {"b": 3, "c": 2}


def test_hydra_reads_every_shipped_file_as_it_is_read_here() -> None:
    files = list(conf_folder().rglob("*.yaml"))
    assert len(files) > 25
    for file in files:
        assert repr(read_yaml(file)) == repr(yaml.load(file.read_text(), Loader=get_yaml_loader())), file


@given(st.integers(-(10**9), 10**9), st.integers(0, 4))
def test_zeros_before_a_number_change_nothing(number, zeros) -> None:
    text = f"{'-' * (number < 0)}{'0' * zeros}{abs(number)}"
    assert plain_yaml.load(f"[{text}]") == [number]


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_in_one_line(text) -> None:
    try:
        plain_yaml.load(text)
    except plain_yaml.NotPlain as error:
        assert "\n" not in str(error)


words = st.text(st.characters(codec="latin-1", categories=("L", "N", "P", "S", "Zs")), max_size=8)
plain_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)


@given(plain_values)
def test_what_json_says_is_read_back(value) -> None:
    assert plain_yaml.load(json.dumps(value, ensure_ascii=False)) == value
