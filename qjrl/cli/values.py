"""The values of overrides before Hydra reads them: what a YAML file would not say alike, or what is said twice, is refused."""

import re
from collections.abc import Collection

from qjrl.config import ConfigError
from qjrl.field_words import cut

_TOKEN = re.compile(r"'(?:\\.|[^'\\])*'|\"(?:\\.|[^\"\\])*\"|[^\[\](){},:\s'\"]+")
_PADDED = re.compile(r"([-+]?)0+(\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)", re.ASCII)
_GROUPED = re.compile(r"(?=.*_)[-+]?(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:[eE][-+]?\d[\d_]*)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"([-+]?\d+),(0\d+)", re.ASCII)
_LONGEST = 80


def checked(overrides: list[str], is_sweep: bool, texts: Collection[str]) -> list[str]:
    """The overrides, numbers as in YAML: 007 is 7.

    Args:
        texts: keys whose values are texts, never numbers.
    Raises:
        ConfigError: ``a==1``, ``1_000``, ``0,03``, one key with two values, or a sweep over nothing.
    """
    _check_once(overrides)
    if is_sweep and not any(_may_sweep(override) for override in overrides):
        raise ConfigError("-m: got no value to sweep over, allowed: several values of a key, as in -m seed=1,2")
    return [override if _key(override) in texts else _as_in_yaml(override) for override in overrides]


def comma_hint(value: str) -> str:
    """Of a value with one comma between digits: ``0,5`` may be a decimal number."""
    match = re.fullmatch(r"([-+]?\d+),(\d+)", value, re.ASCII)
    return f"; a decimal comma? write {match[1]}.{match[2]}" if match else ""


def _check_once(overrides: list[str]) -> None:
    values: dict[str, str] = {}
    for override in overrides:
        key, value = _key(override), override.partition("=")[2]
        if value.startswith("=") and not override.startswith("~"):
            raise ConfigError(f"{_short(override)}: got '=' twice, allowed: {_short(key)}={_short(value.lstrip('='))}")
        if values.setdefault(key, value) != value:
            raise ConfigError(
                f"{_short(key)}: got both {_short(values[key])} and {_short(value)}, allowed: one of them"
            )


def _as_in_yaml(override: str) -> str:
    key, equals, value = override.partition("=")
    if match := _DECIMAL_COMMA.fullmatch(value):
        raise ConfigError(
            f"{key}: got {value}, allowed: numbers such as {match[1]}.{match[2]}, without a decimal comma"
        )
    if "$" in value:
        return override
    for token in _TOKEN.findall(value):
        if _GROUPED.fullmatch(token):
            raise ConfigError(
                f"{key}: got {_short(token)}, allowed: digits without '_', as in {token.replace('_', '')[:_LONGEST]}"
            )
    return key + equals + _TOKEN.sub(_without_padding, value)


def _without_padding(token: re.Match[str]) -> str:
    number = _PADDED.fullmatch(token[0])
    return f"{number[1]}{number[2]}" if number else token[0]


def _may_sweep(override: str) -> bool:
    """Whether it lists several values, or hands the work to a launcher, where a single run has its sense too."""
    key, _, value = override.partition("=")
    return key.lstrip("+").startswith(("hydra/", "hydra.")) or re.search(r",|\w\(", value) is not None


def _key(override: str) -> str:
    return override.partition("=")[0].lstrip("+~")


def _short(text: str) -> str:
    return cut(text if text.isprintable() and text else repr(text))
