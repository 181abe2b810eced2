"""What a field of a configuration allows, and what was got instead, in the words of an error line."""

import dataclasses
import difflib
import functools
import math
import types
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints


@dataclasses.dataclass(frozen=True)
class Range:
    """Bounds of a number, both included unless said otherwise: ``Annotated[float, Range(0, 1)]``."""

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    """Lower bound, itself excluded."""
    below: float = math.inf
    """Upper bound, itself excluded."""

    def __contains__(self, number: float) -> bool:
        return self.low <= number <= self.high and self.above < number < self.below

    def __str__(self) -> str:
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"from {self.low:.12g} to {self.high:.12g}"
        bounds = (("at least", self.low), ("above", self.above), ("at most", self.high), ("below", self.below))
        return " and ".join(f"{word} {bound:.12g}" for word, bound in bounds if math.isfinite(bound))


@dataclasses.dataclass(frozen=True)
class OneOf:
    """Marks a field that holds one of several configuration classes, told apart by a Literal field that all of them have:
    ``Annotated[Any, OneOf(lambda: [Circle, Line])]``. Asked whenever a value is read: a registry may grow."""

    classes: Callable[[], Iterable[type]]


def plain_kind(kind: Any) -> Any:
    """A field type, the classes of a `OneOf` as the union that they are now."""
    if get_origin(kind) in (Union, types.UnionType):
        return Union[tuple(map(plain_kind, get_args(kind)))]  # noqa: UP007
    marks = get_args(kind)[1:] if get_origin(kind) is Annotated else ()
    unions = [Union[tuple(mark.classes())] for mark in marks if isinstance(mark, OneOf)]  # noqa: UP007
    return unions[0] if unions else kind


def known_names(name: str, known: Collection[Any]) -> str:
    """``did you mean 'sample'? known: compare, ik, sample``."""
    names = [str(item) for item in known]
    close = difflib.get_close_matches(name, names, n=1)
    return (f"did you mean '{close[0]}'? " if close else "") + f"known: {', '.join(names) or 'none'}"


@functools.cache
def kinds_of(cls: type) -> dict[str, Any]:
    """Field name -> its type, bounds included."""
    return get_type_hints(cls, include_extras=True)


def describe(kind: Any) -> str:
    """What a field type allows, in words: ``a number from 0 to 1 or null``."""
    kind = plain_kind(kind)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        bounds = [str(bound) for bound in arguments[1:] if isinstance(bound, Range)]
        return " ".join([describe(arguments[0]), *bounds])
    if origin is Literal:
        return "one of " + ", ".join(str(choice) for choice in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(describe(option) for option in arguments)
    if origin is tuple and arguments[-1] is Ellipsis:
        return f"a list, each {describe(arguments[0])}"
    if origin is tuple:
        return f"a list of {len(arguments)}: {', '.join(describe(item) for item in arguments)}"
    if dataclasses.is_dataclass(kind):
        return f"a mapping with the keys {', '.join(field.name for field in dataclasses.fields(kind) if field.init)}"
    return _WORDS.get(origin or kind, str(kind))


_WORDS: dict[Any, str] = {
    int: "an integer",
    float: "a finite number",
    str: "a text",
    bool: "true or false",
    Path: "a path",
    dict: "a mapping",
    types.NoneType: "null",
}


def show(value: Any) -> str:
    """The value as a user would recognise it, on one line, at most 80 characters."""
    names = {None: "null", True: "true", False: "false"}
    text = names[value] if value is None or isinstance(value, bool) else " ".join(repr(value).split())
    return cut(text)


def cut(text: str, longest: int = 80) -> str:
    """The text, its end left out where it is longer than that."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."
