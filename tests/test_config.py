import ast
import dataclasses
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qjrl import pipeline
from qjrl.config import (
    ConfigError,
    NotIdentity,
    Range,
    as_mapping,
    build,
    conf_folder,
    configuration,
    identity_of,
    read_literal_yaml,
    read_yaml,
)


@dataclasses.dataclass(frozen=True)
class Joint:
    length: Annotated[float, Range(above=0.0)]
    limit: Annotated[float, Range(0.0, below=90.0)] = 70.0
    model: Literal["spherical", "rolling"] = "rolling"


@dataclasses.dataclass(frozen=True)
class Arm:
    joint: Joint
    counts: tuple[Annotated[int, Range(1, 10)], ...] = (2, 2)
    angles: tuple[tuple[float, ...], ...] = ()
    hole: tuple[float, float] = (0.0, 90.0)
    payload: Annotated[float, Range(low=0.0)] | None = None
    label: str | int | None = None
    table: Path | None = None
    rolling: bool = True
    extra: dict = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.payload is not None and len(self.counts) > 3:
            raise ValueError("payload: allowed only with at most 3 counts")


def arm(**changes: Any) -> Arm:
    return build(Arm, {"joint": {"length": 0.02}, **changes}, "robot")


def refused(**changes: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        arm(**changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_full_mapping_builds_the_dataclass_with_tuples_for_lists_and_floats_for_ints() -> None:
    built = arm(angles=[[0, 90], [45]], payload=1, label="a", table="x/y.csv", extra={"k": [1]}, counts=[3])
    assert built.angles == ((0.0, 90.0), (45.0,)) and isinstance(built.angles[0][0], float)
    assert built.payload == 1.0 and built.table == Path("x/y.csv") and built.extra == {"k": [1]}
    assert built.joint == Joint(length=0.02)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joint": {"length": -1}}, "robot.joint.length: got -1, allowed: a finite number above 0"),
        ({"joint": {"length": "1"}}, "robot.joint.length: got '1', allowed: a finite number above 0"),
        ({"joint": {"length": math.nan}}, "robot.joint.length: got nan, allowed: a finite number above 0"),
        ({"joint": {"length": math.inf}}, "robot.joint.length: got inf, allowed: a finite number above 0"),
        (
            {"joint": {"length": 1, "limit": 90}},
            "robot.joint.limit: got 90, allowed: a finite number at least 0 and below 90",
        ),
        (
            {"joint": {"length": 1, "model": "rollin"}},
            "robot.joint.model: got 'rollin', allowed: one of spherical, rolling",
        ),
        ({"joint": {}}, "robot.joint.length: missing, allowed: a finite number above 0"),
        ({"joint": None}, "robot.joint: got null, allowed: a mapping with the keys length, limit, model"),
        ({"counts": 2}, "robot.counts: got 2, allowed: a list, each an integer from 1 to 10"),
        ({"counts": [2, 0]}, "robot.counts[1]: got 0, allowed: an integer from 1 to 10"),
        ({"counts": [True]}, "robot.counts[0]: got true, allowed: an integer from 1 to 10"),
        ({"counts": [2.0]}, "robot.counts[0]: got 2.0, allowed: an integer from 1 to 10"),
        ({"angles": [[0, "a"]]}, "robot.angles[0][1]: got 'a', allowed: a finite number"),
        ({"hole": [1]}, "robot.hole: got [1], allowed: a list of 2: a finite number, a finite number"),
        ({"payload": -0.5}, "robot.payload: got -0.5, allowed: a finite number at least 0 or null"),
        ({"label": 1.5}, "robot.label: got 1.5, allowed: a text or an integer or null"),
        ({"rolling": 1}, "robot.rolling: got 1, allowed: true or false"),
        ({"extra": [1]}, "robot.extra: got [1], allowed: a mapping"),
        ({"payload": 1, "counts": [1, 1, 1, 1]}, "robot.payload: allowed only with at most 3 counts"),
    ],
)
def test_a_value_that_is_not_allowed_is_one_line_with_key_value_and_what_is_allowed(changes, message) -> None:
    assert refused(**changes) == message


def test_an_unknown_key_is_refused_with_what_was_probably_meant() -> None:
    message = refused(joint={"length": 1, "limmit": 3})
    assert message == (
        "robot.joint.limmit: got 3, but there is no such key; did you mean 'limit'? known: length, limit, model"
    )


def test_a_long_value_is_shortened_to_one_line() -> None:
    assert len(refused(counts="x\n" * 1000)) < 200


plain_arms = st.fixed_dictionaries(
    {"joint": st.fixed_dictionaries({"length": st.floats(1e-6, 1e6)}, optional={"model": st.just("spherical")})},
    optional={
        "counts": st.lists(st.integers(1, 10), max_size=3),
        "angles": st.lists(st.lists(st.floats(-360, 360)), max_size=3),
        "payload": st.none() | st.floats(0, 10),
        "label": st.none() | st.text() | st.integers(),
        "rolling": st.booleans(),
    },
)


@given(plain_arms)
def test_as_mapping_is_the_inverse_of_build(mapping) -> None:
    built = build(Arm, mapping)
    assert build(Arm, as_mapping(built)) == built
    assert all(as_mapping(built)[key] == value for key, value in mapping.items() if key != "joint")


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(), lambda x: st.lists(x) | st.dictionaries(st.text(), x)
    )
)
def test_whatever_is_given_either_builds_or_is_refused_in_one_line(anything) -> None:
    try:
        build(Arm, anything)
    except ConfigError as error:
        assert "\n" not in str(error)


def test_a_key_that_cannot_be_printed_is_quoted() -> None:
    with pytest.raises(ConfigError, match=r"^'a\\nb': got null, but there is no such key"):
        build(Arm, {"a\nb": None})


def test_yaml_numbers_with_an_exponent_are_numbers(tmp_path) -> None:
    (tmp_path / "a.yaml").write_text("a: 1e-3\nb: 2E5\nc: 1.5e3\nd: 7\ne: e5\n")
    assert read_yaml(tmp_path / "a.yaml") == {"a": 0.001, "b": 2e5, "c": 1500.0, "d": 7, "e": "e5"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        ("a: [1", "is not YAML"),
        ("- 1", "expected a mapping"),
        (b"\xff\xfe\x00", "UTF-16, allowed: UTF-8; save it as UTF-8"),
    ],
)
def test_a_yaml_file_that_cannot_be_used_is_one_line(tmp_path, content, message) -> None:
    path = tmp_path / "arm.yaml"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError, match=message) as caught:
        read_yaml(path)
    assert "\n" not in str(caught.value) and "arm.yaml" in str(caught.value)


def test_every_shipped_yaml_file_is_a_mapping() -> None:
    files = sorted(conf_folder().rglob("*.yaml"))
    assert files
    for file in files:
        read_yaml(file)


@dataclasses.dataclass(frozen=True)
class Marked:
    inner: Joint
    threads: Annotated[int, Range(0, 8), NotIdentity()] = 0
    batch: Annotated[int, NotIdentity(lambda config: config.engine == "c")] = 4
    engine: str = "c"


def test_a_field_that_cannot_change_a_result_is_no_identity_and_all_others_are() -> None:
    marked = Marked(Joint(1.0))
    assert identity_of(marked) == {"inner": as_mapping(Joint(1.0)), "engine": "c"}
    assert identity_of(dataclasses.replace(marked, engine="mjx")).keys() == {"inner", "batch", "engine"}
    assert as_mapping(marked).keys() == {"inner", "threads", "batch", "engine"}


NO_IDENTITY = [
    "deploy.port",
    "forward_model.kind",  # of the network, from before there were others
    "model_study.corrected.kind",
    "model_study.paper.kind",
    "policy.tensorboard",
    "sample.shard_size",
    "simulation.batch_size",  # in C MuJoCo
    "simulation.num_threads",
]
"""All fields of all stages that cannot change a result, beside `sample.shard` and `num_shards`, of which the whole knows nothing."""


def test_only_these_fields_of_the_stages_are_no_identity() -> None:
    def leaves(value: Any, where: str = "") -> Iterator[str]:
        if not isinstance(value, dict):
            yield where
            return
        for key, item in value.items():
            yield from leaves(item, f"{where}.{key}" if where else key)

    found: set[str] = set()
    for group in pipeline.GROUPS:
        settings = build(pipeline.kind_of(group), {})
        found |= {*leaves({group: as_mapping(settings)})} - {*leaves({group: identity_of(settings)})}
    assert sorted(found) == NO_IDENTITY
    in_mjx = identity_of(pipeline.kind_of("simulation")(backend="mjx"))
    assert "batch_size" in in_mjx and "num_threads" not in in_mjx


@pytest.mark.parametrize("content", ["defaults: [x]\n", "a: ${seed}\n", "a: {b: ['${x}']}\n", "a: ???\n", "${a}: 1\n"])
def test_a_file_of_values_composes_nothing(tmp_path, content) -> None:
    (tmp_path / "arm.yaml").write_text(content)
    with pytest.raises(ConfigError, match=r"arm\.yaml: .*allowed: the value"):
        read_literal_yaml(tmp_path / "arm.yaml")


def test_a_number_beyond_floats_is_refused() -> None:
    assert "a finite number" in refused(joint={"length": 10**400})


# --- what Python makes ------------------------------------------------------------------------------------------------


@configuration
class Inner:
    share: Annotated[float, Range(0.0, 1.0)] = 0.5


@configuration
class Outer:
    count: Annotated[int, Range(1, 9)]
    mode: Literal["a", "b"] = "a"
    sizes: tuple[Annotated[float, Range(above=0.0)], ...] = ()
    inner: Inner = Inner()

    def __post_init__(self):
        if self.count == 7:
            raise ValueError("count: got 7, allowed: another")


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"count": 0}, "Outer.count: got 0, allowed: an integer from 1 to 9"),
        ({"count": 2.0}, "Outer.count: got 2.0"),
        ({"count": True}, "Outer.count: got true"),
        ({"count": 1, "mode": "c"}, "Outer.mode: got 'c', allowed: one of a, b"),
        ({"count": 1, "sizes": [1.0, -2.0]}, "Outer.sizes[1]: got -2.0"),
        ({"count": 1, "sizes": np.array([1.0, np.nan])}, "Outer.sizes[1]: got nan"),
        ({"count": 1, "inner": 3}, "Outer.inner: got 3"),
        ({"count": 7}, "count: got 7, allowed: another"),
    ],
    ids=str,
)
def test_what_python_makes_is_refused_as_what_yaml_makes(values, line) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(line)):
        Outer(**values)
    with pytest.raises(ValueError, match=r"Outer\.count: got 12"):
        dataclasses.replace(Outer(1), count=12)


def test_numbers_of_numpy_become_plain_ones_with_the_same_hash() -> None:
    from qjrl.artifacts import hash_of

    values: tuple[Any, ...] = (np.int64(3), np.str_("b"), np.array([1.0, 2.0]), Inner(np.float64(0.25)))
    given = Outer(*values)
    plain = Outer(3, "b", (1.0, 2.0), Inner(0.25))
    assert given == plain and type(given.count) is int and type(given.inner.share) is float
    assert hash_of(as_mapping(given)) == hash_of(as_mapping(plain))
    assert (
        build(Outer, {"count": np.int32(3), "mode": "b", "sizes": np.array([1, 2]), "inner": {"share": 0.25}}) == plain
    )


def test_every_class_with_ranges_is_checked_wherever_it_is_made() -> None:
    package = Path(__file__).parent.parent / "qjrl"
    for file in package.rglob("*.py"):
        classes = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.ClassDef)]
        for node in classes:
            if node.name not in ("Range", "NotIdentity") and "Range(" in ast.unparse(node):
                assert [ast.unparse(one) for one in node.decorator_list] == ["configuration"], f"{file}: {node.name}"
