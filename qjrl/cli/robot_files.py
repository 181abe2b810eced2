"""``robot=FILE.yaml``: the file is read here, as `load_robot` reads it, and Hydra is given its content under a plain name."""

import re
from collections.abc import Mapping
from pathlib import Path

from qjrl.cli.arguments import is_file
from qjrl.config import conf_folder, is_yaml, read_literal_yaml

_SUFFIXES = (".yaml", ".yml")
_NO_NAMES = ("null", "true", "false", "inf", "nan")


def with_robot_files(overrides: list[str]) -> tuple[list[str], dict[str, str]]:
    """The overrides with a choice in place of each robot's file, and choice -> file as the user wrote it.

    Raises:
        ConfigError: a file cannot be read.
    """
    from hydra.core.config_store import ConfigStore

    files: dict[str, str] = {}
    result = []
    for override in overrides:
        key, _, value = override.partition("=")
        if key.lstrip("+") != "robot" or not any(suffix in value.lower() for suffix in _SUFFIXES):
            result.append(override)
            continue
        choices = [_choice(piece, files) if is_yaml(piece) else piece for piece in _pieces(value)]
        result.append(f"{key}={','.join(choices)}")
    for choice, file in files.items():
        content = read_literal_yaml(file)
        ConfigStore.instance().store(group="robot", name=choice, node=content)
    return result, files


def as_typed(overrides: list[str], files: Mapping[str, str]) -> list[str]:
    """Overrides of a job for its record: with the user's files instead of the choices made of them."""
    result = []
    for override in overrides:
        key, equals, value = override.partition("=")
        is_file = key.lstrip("+") == "robot" and value in files
        result.append(f"{key}{equals}{files[value]}" if is_file else override)
    return result


def _choice(file: str, files: dict[str, str]) -> str:
    """A name that Hydra's grammar reads and that no shipped arm or other file has."""
    taken = {path.stem for path in (conf_folder() / "robot").glob("*.yaml")}
    stem = re.sub(r"[^A-Za-z0-9_]", "_", Path(file).stem)
    if not re.match(r"[A-Za-z]", stem) or stem.lower() in _NO_NAMES:
        stem = f"arm_{stem}"
    while stem in taken or files.get(stem, file) != file:
        stem += "_"
    files[stem] = file
    return stem


def _pieces(value: str) -> list[str]:
    """The files and choices that a value lists; a name with commas in it is taken whole where there is such a file."""
    if is_file(value):
        return [value]
    parts, pieces = _outside_quotes(value), []
    while parts:
        whole = next((end for end in range(len(parts), 1, -1) if is_file(",".join(parts[:end]))), 1)
        pieces.append(",".join(parts[:whole]))
        parts = parts[whole:]
    return [_unquoted(piece.strip()) for piece in pieces]


def _outside_quotes(value: str) -> list[str]:
    return re.findall(r"\s*(?:'(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\")\s*(?=,|$)|[^,]+", value)


def _unquoted(piece: str) -> str:
    if len(piece) > 1 and piece[0] == piece[-1] and piece[0] in "'\"":
        return re.sub(r"\\(['\"\\])", r"\1", piece[1:-1])
    return piece
