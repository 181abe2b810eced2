"""The arguments of the command, sorted and in the words that Hydra's grammar reads; a slip is named before Hydra sees it."""

import re
from collections.abc import Collection
from pathlib import Path

from qjrl.config import ConfigError, is_yaml, known_names

_NO_VALUE, _ONE_VALUE, _MAYBE_VALUE = "no value", "one value", "a value or none"
_OPTIONS = {
    **dict.fromkeys(["--multirun", "-m", "--run", "-r", "--resolve", "--hydra-help", "--shell-completion"], _NO_VALUE),
    **dict.fromkeys(["--cfg", "-c", "--package", "-p", "--config-dir", "-cd", "--config-name", "-cn"], _ONE_VALUE),
    **dict.fromkeys(["--info", "-i"], _MAYBE_VALUE),
}
_CHOICES = {
    **dict.fromkeys(["--cfg", "-c"], ("job", "hydra", "all")),
    **dict.fromkeys(["--info", "-i"], ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")),
}
TEXTS = ("name",)
"""Keys whose values are texts: ``name=2024`` and ``name=O'Brien`` need no quotes."""
_FILES = (".csv", ".json", ".jsonl", ".npz", ".yaml", ".yml")


def sorted_out(arguments: list[str], stages: Collection[str]) -> tuple[list[str], list[str]]:
    """The overrides (KEY=VALUE, ~KEY) and the options, in whatever order they were given.

    Raises:
        ConfigError: an option that does not exist or lacks its value, or a word that is neither.
    """
    overrides, options, waiting = [], [], list(arguments)
    words = []
    while waiting:
        argument = waiting.pop(0)
        if argument.startswith("-"):
            options += _option(argument, waiting)
        elif "=" in argument or argument.startswith("~"):
            overrides.append(argument)
        else:
            words.append(argument)
    if words:
        raise ConfigError(_hint(words, stages))
    return overrides, options


def _option(argument: str, waiting: list[str]) -> list[str]:
    name, equals, value = argument.partition("=")
    if name not in _OPTIONS:
        raise ConfigError(f"{name}: no such option; {known_names(name, [*_OPTIONS, '--help', '--version'])}")
    kind, choices = _OPTIONS[name], _CHOICES.get(name)
    if equals and kind == _NO_VALUE:
        raise ConfigError(f"{argument}: {name} takes no value")
    given = [value] if equals else []
    if not given and waiting and kind == _ONE_VALUE:
        given = [waiting.pop(0)]
    if not given and waiting and kind == _MAYBE_VALUE and waiting[0] in (choices or ()):
        given = [waiting.pop(0)]
    if (kind == _ONE_VALUE and not given) or (given and choices and given[0] not in choices):
        got = f"got '{given[0]}', " if given else ""
        raise ConfigError(f"{name}: {got}allowed: {', '.join(choices) if choices else 'a value'}")
    return [name, *given]


def _hint(words: list[str], stages: Collection[str]) -> str:
    if all(word in stages for word in words):
        return f"{' '.join(words)}: is no KEY=VALUE; did you mean stages=[{','.join(words)}]?"
    word = next(word for word in words if word not in stages)
    if is_yaml(word):
        return f"{word}: is no KEY=VALUE; did you mean robot={word}?"
    shown = word if word.isprintable() and word else repr(word)
    close = known_names(word, stages)
    hint = f"; {close.partition('?')[0]}? then stages=[...]" if "did you mean" in close else ""
    return f"{shown}: expected KEY=VALUE{hint}; qjrl --help shows how"


def quoted(text: str) -> str:
    """A text that Hydra's grammar takes as it is."""
    escaped = re.sub(r"(\\*)'", lambda match: 2 * match[1] + r"\'", text)
    trailing = len(escaped) - len(escaped.rstrip("\\"))
    return f"'{escaped}{'\\' * trailing}'"


def for_hydra(override: str) -> str:
    """The override, its value in quotes where Hydra's lexer would not read it as the text it is: the name of a run or of
    a file, letters beyond ASCII."""
    key, equals, value = override.partition("=")
    if not equals:
        return override
    if value.lower().endswith(_FILES) and is_file(value):
        return f"{key}={quoted(value.replace('${', chr(92) + '${'))}"
    if key in TEXTS and value and not (set(value) & set(",[]{}()$") or value[0] in "'\""):
        return f"{key}={quoted(value)}"
    if value.isascii() or set(value) & set("'\"{}\\$"):
        return override
    return f"{key}={re.sub(r'[^\[\](),]+', lambda match: _beyond_ascii(match[0]), value)}"


def _beyond_ascii(text: str) -> str:
    return text if text.isascii() else quoted(text.strip())


def is_file(name: str) -> bool:
    """Whether there is a file of that name, whatever the name."""
    try:
        return Path(name).expanduser().is_file()
    except (OSError, ValueError, RuntimeError):
        return False
