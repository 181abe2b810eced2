"""Records: what is read from a file and then asked by key, checked before anything asks."""

from collections.abc import Collection, Mapping
from types import UnionType
from typing import Any, Union

Kinds = Mapping[str, Union[type, UnionType, "Kinds"]]
"""Key -> type of its value, or the kinds of the mapping that stands there."""
NUMBER = int | float | None
"""A measured number; null stands for NaN."""


class ArtifactError(ValueError):
    """A file is missing, damaged, or belongs to something else. The message is the one line a user reads."""


def check_record(path: Any, record: Any, kinds: Kinds, what: str) -> dict[str, Any]:
    """The record, if it is a mapping with the keys `kinds`; it may have others too.

    Args:
        path: of the file, for the message.
        what: what the file is, for the message.
    Raises:
        ArtifactError: it is no mapping, lacks a key, or holds something else there.
    """
    if not isinstance(record, dict):
        raise ArtifactError(f"{path}: is not {what} (holds no mapping)")
    if wrong := _wrong(record, kinds, ""):
        raise ArtifactError(f"{path}: is not {what} ({wrong}); it is damaged, or another program wrote it")
    return record


def reason_of(error: BaseException) -> str:
    """Why bytes cannot be read, on one line; NumPy's advice to trust pickled data is none for a user."""
    if "pickle" in str(error):
        return "its bytes are none of NumPy's arrays, or hold Python objects"
    return " ".join(str(error).split()) or type(error).__name__


def holds_numbers(record: Any) -> bool:
    """Whether it is a mapping with numbers, or null, as all of its values."""
    return isinstance(record, dict) and _wrong(record, dict.fromkeys(record, NUMBER), "") is None


def check_names(path: Any, found: Collection[str], needed: Collection[str], what: str) -> None:
    """Raises an ArtifactError where a file lacks names (of arrays, of columns)."""
    if missing := [name for name in needed if name not in found]:
        raise ArtifactError(f"{path}: is not {what} ({', '.join(missing)} is missing); another program wrote it")


def _wrong(record: Mapping[str, Any], kinds: Kinds, where: str) -> str | None:
    for key, kind in kinds.items():
        name = f"{where}{key}"
        if key not in record:
            return f"{name} is missing"
        value, expected = record[key], dict if isinstance(kind, Mapping) else kind
        if not isinstance(value, expected) or isinstance(value, bool):
            return f"{name} is {type(value).__name__}"
        if isinstance(kind, Mapping) and (wrong := _wrong(value, kind, f"{name}.")):
            return wrong
    return None
