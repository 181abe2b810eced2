"""A union of configuration classes: the Literal field that tells them apart, its errors, and registries that grow."""

import re
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from qjrl.config import ConfigError, OneOf, Range, as_mapping, configuration
from qjrl.config import build as typed_build
from qjrl.tagged_union import tags_of

build: Any = typed_build  # a union is no type to the type checker


@configuration
class Circle:
    kind: Literal["circle"] = "circle"
    radius: Annotated[float, Range(above=0.0)] = 1.0


@configuration
class Line:
    kind: Literal["line", "segment"]
    length: Annotated[float, Range(above=0.0)] = 1.0
    width: float = 0.0


@configuration
class Blob:
    kind: Literal["blob"] = "blob"


REGISTRY: dict[str, type] = {"circle": Circle, "line": Line}
Registered = Annotated[Any, OneOf(lambda: REGISTRY.values())]


@configuration
class Drawing:
    shape: Circle | Line = Circle()
    others: tuple[Circle | Line, ...] = ()
    maybe: Circle | Line | None = None
    registered: Registered = Circle()


@pytest.mark.parametrize(
    ("mapping", "expected"),
    [
        ({}, Circle()),
        ({"radius": 2}, Circle(radius=2.0)),
        ({"kind": "line"}, Line("line")),
        ({"kind": "segment", "length": 3}, Line("segment", 3.0)),
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", [Circle | Line, Registered], ids=["union", "registry"])
def test_the_literal_field_names_the_class_and_without_it_the_first_with_a_default_is_meant(kind, mapping, expected):
    assert build(kind, mapping, "shape") == expected
    assert build(kind, as_mapping(expected)) == expected


@pytest.mark.parametrize(
    ("mapping", "line"),
    [
        ({"shape": {"kind": "foo"}}, "shape.kind: got 'foo', allowed: one of circle, line, segment"),
        ({"shape": {"kind": ["line"]}}, "shape.kind: got ['line'], allowed: one of circle, line, segment"),
        ({"shape": {"kind": None}}, "shape.kind: got null, allowed: one of circle, line, segment"),
        ({"shape": {"radius": -1}}, "shape.radius: got -1, allowed: a finite number above 0"),
        ({"shape": {"kind": "line", "length": "x"}}, "shape.length: got 'x', allowed: a finite number above 0"),
        (
            {"shape": {"kind": "line", "lenght": 1}},
            "shape.lenght: got 1, but there is no such key; did you mean 'length'? known: kind, length, width",
        ),
        ({"shape": {"kind": "line", "radius": 1}}, "shape.radius: got 1, allowed with kind=circle"),
        ({"shape": {"width": 1}}, "shape.width: got 1, allowed with kind=line or segment"),
        ({"others": [{}, {"kind": "foo"}]}, "others[1].kind: got 'foo', allowed: one of circle, line, segment"),
        ({"maybe": {"kind": "foo"}}, "maybe.kind: got 'foo', allowed: one of circle, line, segment"),
        ({"registered": {"kind": "foo"}}, "registered.kind: got 'foo', allowed: one of circle, line, segment"),
        ({"registered": {"radius": 0}}, "registered.radius: got 0, allowed: a finite number above 0"),
        (
            {"shape": 3},
            "shape: got 3, allowed: a mapping with the keys kind, radius or a mapping with the keys kind, length, width",
        ),
    ],
    ids=str,
)
def test_what_is_wrong_in_a_union_is_one_line_with_its_key(mapping, line):
    with pytest.raises(ConfigError, match="^" + re.escape(line) + "$"):
        build(Drawing, mapping)


def test_where_no_class_has_a_default_the_field_must_be_said():
    with pytest.raises(ConfigError, match=r"^shape\.kind: missing, allowed: one of line, segment, other$"):
        build(Line | Other, {}, "shape")


@configuration
class Other:
    kind: Literal["other"]


def test_a_registry_may_grow_and_be_of_one_class(monkeypatch):
    with pytest.raises(ConfigError, match=r"kind: got 'blob', allowed: one of circle, line, segment"):
        build(Registered, {"kind": "blob"})
    monkeypatch.setitem(REGISTRY, "blob", Blob)
    assert build(Registered, {"kind": "blob"}) == Blob() and Drawing(registered=Blob()).registered == Blob()
    monkeypatch.delitem(REGISTRY, "blob")
    monkeypatch.delitem(REGISTRY, "line")
    assert build(Registered, {}) == Circle()
    with pytest.raises(ConfigError, match=r"^shape\.kind: got 'line', allowed: one of circle$"):
        build(Registered, {"kind": "line"}, "shape")


def test_what_python_makes_is_taken_and_held_against_the_classes():
    drawing = Drawing(shape=Line("segment"), others=(Line("line"), Circle()), maybe=Circle())
    assert drawing.others == (Line("line"), Circle())
    with pytest.raises(ConfigError, match=r"Drawing\.shape: got .*Blob"):
        Drawing(shape=Blob())  # pyright: ignore[reportArgumentType]


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.sampled_from(["circle", "line", "x"]),
        lambda x: st.lists(x) | st.dictionaries(st.sampled_from(["kind", "radius", "length", "shape", "others"]), x),
    )
)
def test_whatever_is_given_either_builds_and_comes_back_or_is_refused_in_one_line(anything):
    try:
        built = build(Drawing, anything)
    except ConfigError as error:
        assert "\n" not in str(error)
    else:
        assert build(Drawing, as_mapping(built)) == built


def test_classes_without_a_literal_of_different_values_have_no_tag():
    @configuration
    class Also:
        kind: Literal["circle"] = "circle"
        side: float = 1.0

    assert tags_of(Circle | Also) is None and tags_of(Circle | None) is None and tags_of(Circle) is None
    assert build(Circle | Also, {"side": 2.0}) == Also(side=2.0)
