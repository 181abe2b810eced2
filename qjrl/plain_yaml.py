"""YAML as an engineer means it: decimal numbers, ``true`` and ``false``, every key once.

PyYAML reads YAML 1.1, where 065 is 53, 1:30 is 90, ``on`` and ``no`` are booleans and 2024-05-01 is a date. Here numbers
are decimal (065 is 65), only true and false are booleans, and everything else is a text.
"""

import re
from collections.abc import Callable
from typing import Any, ClassVar

import yaml

MOST_VALUES = 100_000
"""Values in one file, those behind anchors counted each time they are used."""
DEEPEST = 50
"""Lists and mappings inside each other."""


class NotPlain(ValueError):  # noqa: N818
    """The text is no YAML that this module reads. The message is one line, with the line of the text where there is one."""


def load(text: str) -> Any:
    """The content of one YAML document: mappings with texts as keys, lists, texts, numbers, booleans and null.

    Raises:
        NotPlain: broken syntax, a key that stands twice or is no text, a tag, or more than `MOST_VALUES`.
    """
    try:
        content = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise NotPlain(f"{line}{' '.join(str(error.problem or error.context).split())}") from error
    except yaml.YAMLError as error:
        raise NotPlain(" ".join(str(error).split())) from error
    except RecursionError as error:
        raise NotPlain("its lists and mappings are nested too deeply") from error
    _count(content, MOST_VALUES, 0)
    return content


def _count(value: Any, left: int, depth: int) -> int:
    """How many more values are allowed after this one."""
    if left <= 0 or depth > DEEPEST:
        what = f"holds more than {MOST_VALUES} values" if left <= 0 else f"is nested deeper than {DEEPEST} levels"
        raise NotPlain(f"it {what}; an anchor inside itself does that")
    left -= 1
    if isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            left = _count(item, left, depth + 1)
    return left


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str | None, Any] = {}  # noqa: RUF012
    yaml_constructors: ClassVar[dict[Any, Any]] = {}

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen: set[str] = set()
        for key, _ in node.value:
            if key.tag == _tag("merge"):
                continue
            if key.tag != _tag("str") or not isinstance(key, yaml.ScalarNode):
                got = repr(key.value) if isinstance(key, yaml.ScalarNode) else "a list or a mapping"
                self._refuse(key, f"a key must be a text, got {got.strip(chr(39))}")
            if key.value in seen:
                self._refuse(key, f"the key {key.value!r} stands twice")
            seen.add(key.value)
        return node

    @staticmethod
    def _refuse(node: yaml.Node, problem: str) -> None:
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)


def _tag(name: str) -> str:
    return f"tag:yaml.org,2002:{name}"


def _boolean(text: str) -> bool:
    return {"true": True, "false": False}[text.lower()]


def _float(text: str) -> float:
    lower = text.lower()
    return float(lower.replace(".inf", "inf").replace(".nan", "nan"))


def _null(text: str) -> None:
    return None


_SCALARS: dict[str, tuple[str, list[str], Callable[[str], Any]]] = {
    "null": (r"(~|null|Null|NULL|)$", ["~", "n", "N", ""], _null),
    "bool": (r"(true|True|TRUE|false|False|FALSE)$", list("tTfF"), _boolean),
    "int": (r"[-+]?[0-9]+$", list("-+0123456789"), int),
    "float": (
        r"[-+]?((\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$",
        list("-+.0123456789"),
        _float,
    ),
}


def _reader(name: str, convert: Callable[[str], Any]) -> Callable[[Any, Any], Any]:
    def read(loader: Any, node: Any) -> Any:
        try:
            return convert(loader.construct_scalar(node))
        except (ValueError, KeyError):
            loader._refuse(node, f"{str(node.value)[:40]!r} cannot be read as {name}")

    return read


for _name, (_pattern, _starts, _convert) in _SCALARS.items():
    _Loader.add_implicit_resolver(_tag(_name), re.compile(_pattern), _starts)
    _Loader.add_constructor(_tag(_name), _reader(_name, _convert))
_Loader.add_implicit_resolver(_tag("merge"), re.compile(r"<<$"), ["<"])
_Loader.add_constructor(_tag("str"), yaml.SafeLoader.construct_yaml_str)
_Loader.add_constructor(_tag("seq"), yaml.SafeLoader.construct_yaml_seq)
_Loader.add_constructor(_tag("map"), yaml.SafeLoader.construct_yaml_map)
_Loader.add_constructor(None, yaml.SafeLoader.construct_undefined)
