"""A robot from a shipped name, a YAML file or a plain mapping; the mapping's `kind` says which description reads it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from qjrl.artifacts import hash_of
from qjrl.config import ConfigError, as_mapping, build, conf_folder, in_file, is_yaml, known_names, read_literal_yaml
from qjrl.field_words import show
from qjrl.robot.kind import Robot
from qjrl.robot.kinds import KINDS


def load_robot(name_or_path: str | Path) -> Robot:
    """A robot by shipped name ("qj_2222") or by the path of a YAML file.

    Raises:
        ConfigError: no such robot, or a value in the file that is not allowed; one line.
    """
    if not isinstance(name_or_path, (str, Path)):
        hint = "; robot_from_mapping takes a mapping" if isinstance(name_or_path, Mapping) else ""
        raise ConfigError(f"robot: got {show(name_or_path)}, allowed: a shipped name or the path of a .yaml file{hint}")
    name = str(name_or_path)
    if not is_yaml(name):
        folder = conf_folder() / "robot"
        shipped = sorted(file.stem for file in folder.glob("*.yaml"))
        if name not in shipped:
            known = known_names(name, shipped)
            raise ConfigError(f"robot: got {show(name)}, allowed: the path of a .yaml file or a shipped name; {known}")
        return robot_from_mapping(read_literal_yaml(folder / f"{name}.yaml"))
    content = read_literal_yaml(name)
    try:
        return robot_from_mapping(content)
    except ConfigError as error:
        raise in_file(name, error) from error


def robot_from_mapping(mapping: Mapping[str, Any]) -> Robot:
    """A robot from the content of its YAML.

    Raises:
        ConfigError: unknown kind or key, wrong type, impossible value; one line.
    """
    if not isinstance(mapping, Mapping):
        raise ConfigError(f"robot: got {show(mapping)}, allowed: a mapping, as the YAML of a robot holds it")
    if "kind" not in mapping and isinstance(mapping.get("robot"), Mapping):
        raise ConfigError(
            "robot.robot: got a mapping, allowed: its keys themselves at the top, without robot: above them"
        )
    if "kind" not in mapping:
        raise ConfigError(f"robot.kind: missing, allowed: {', '.join(KINDS)}")
    kind = mapping["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        raise ConfigError(f"robot.kind: got {kind!r}, allowed: {', '.join(KINDS)}")
    try:
        return KINDS[kind].make(build(KINDS[kind].description, mapping, "robot"))
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(f"robot.{error}") from error


def robot_hash(robot: Robot) -> str:
    """Hash of all that describes a robot; data carry it, so that another robot's are refused."""
    return hash_of(as_mapping(robot.config))
