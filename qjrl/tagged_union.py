"""Unions of configuration classes: ``Circle | Line``, or those of a registry by `OneOf`.

A Literal field that all of them have tells them apart, such as ``kind: circle``. Where a mapping does not hold it, the first
class is meant whose field has a default.
"""

import dataclasses
from typing import Annotated, Any, Literal, get_args, get_origin

from qjrl.field_words import kinds_of, plain_kind


@dataclasses.dataclass(frozen=True)
class Tags:
    """How the classes of a union are told apart."""

    name: str
    """Of the field that all of them have."""
    classes: dict[Any, Any]
    """Its value -> the class."""

    @property
    def default(self) -> type | None:
        """The first class whose field has a default."""
        by_field = {cls: {one.name: one for one in dataclasses.fields(cls)}[self.name] for cls in self.classes.values()}
        return next((cls for cls, field in by_field.items() if field.default is not dataclasses.MISSING), None)


def tags_of(kind: Any) -> Tags | None:
    """How the classes of a union are told apart: by their first Literal field of the same name whose values differ."""
    classes = [
        option for option in get_args(plain_kind(kind)) if isinstance(option, type) and dataclasses.is_dataclass(option)
    ]
    literals = [{name: _choices(field) for name, field in kinds_of(cls).items()} for cls in classes]
    for name in literals[0] if len(classes) > 1 else ():
        pairs = [(choice, cls) for cls, found in zip(classes, literals, strict=True) for choice in found.get(name, ())]
        if all(found.get(name) for found in literals) and len({choice for choice, _ in pairs}) == len(pairs):
            return Tags(name, dict(pairs))
    return None


def _choices(kind: Any) -> tuple[Any, ...]:
    """Of a Literal, with marks or without."""
    inner = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    return get_args(inner) if get_origin(inner) is Literal else ()
