"""JSON that every reader of JSON reads: mappings, lists, texts, numbers, true, false and null; no NaN, no infinity."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Dicts, lists, numbers and texts only: arrays, tuples and paths become what JSON holds."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
        return [plain(item) for item in value]
    return value.as_posix() if isinstance(value, Path) else value


def dumps(value: Any, indent: int | None = None) -> str:
    """The JSON of a value; a number that is not finite is null there, for JSON has no such number."""
    return json.dumps(_finite(plain(value)), indent=indent, allow_nan=False)


def numbers_again(content: Any) -> Any:
    """The content of a file of measured numbers, in which null stands for NaN: with NaN, so that arithmetic goes on."""
    if isinstance(content, dict):
        return {key: numbers_again(item) for key, item in content.items()}
    if isinstance(content, list):
        return [numbers_again(item) for item in content]
    return math.nan if content is None else content


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
