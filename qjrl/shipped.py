"""What the shipped YAML files say of a key: such values are known to be allowed without asking the code that uses them."""

from collections.abc import Iterable, Mapping
from typing import Any

from qjrl.config import conf_folder, read_yaml


def says(group: str, value: Any) -> bool:
    """Whether each part of the value of a group stands, under the same keys, in a choice of it or in an experiment."""
    folder = conf_folder()
    choices = [_with_groups(read_yaml(path)) for path in (folder / group).glob("*.yaml")]
    if not choices:
        return False
    if _is_among(value, choices):
        return True
    experiments = [read_yaml(path) for path in (folder / "experiment").glob("*.yaml")]
    return _is_among(value, [*choices, *(one[group] for one in experiments if group in one)])


def _with_groups(content: dict[str, Any]) -> dict[str, Any]:
    """A file's own content, and that of the groups which its defaults list puts under keys: ``/forward_model@paper: paper``."""
    for entry in content.get("defaults", []):
        for source, choice in entry.items() if isinstance(entry, dict) else ():
            group, _, key = source.lstrip("/").partition("@")
            if key and not source.startswith("override "):  # of another group
                content = {key: read_yaml(conf_folder() / group / f"{choice}.yaml")} | content
    return content


def _is_among(value: Any, options: Iterable[Any]) -> bool:
    if not isinstance(value, Mapping):
        return any(type(value) is type(option) and value == option for option in options)
    mappings = [option for option in options if isinstance(option, Mapping)]
    if not value:
        return {} in mappings
    return all(_is_among(item, [one[key] for one in mappings if key in one]) for key, item in value.items())
