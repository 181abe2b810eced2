"""The defaults of the dataclasses, the first entry of `conf/config.yaml`: what a file or the command says comes on top.

A run is told only which groups there are, so that no stage is imported before it: what nobody sets gets its default where a
stage's Config is built, and what somebody sets is checked there. Whoever prints the configuration is told all of it.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from qjrl import pipeline
from qjrl.cli import process
from qjrl.config import as_mapping, build, conf_folder
from qjrl.tagged_union import tags_of

NAME = "defaults"
"""Of the entry."""
_OF_RUNS = {"--multirun", "-m", "--run", "-r"}


def register(is_whole: bool, said: Mapping[str, Any] = {}) -> None:
    """Makes the entry known to Hydra.

    Args:
        is_whole: with every key. Otherwise the groups are empty, and open to any key.
        said: as in `of_groups`.
    """
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf

    groups = of_groups(said) if is_whole else {group: {} for group in pipeline.GROUPS}
    node: Any = OmegaConf.create(as_mapping(pipeline.RunConfig()) | groups)
    for group in () if is_whole else groups:
        OmegaConf.set_struct(node[group], False)
    ConfigStore.instance().store(name=NAME, node=node)


def register_for(overrides: Iterable[str], options: Iterable[str]) -> None:
    """`register` for a command: whole where it does more than run, or names its directory by a key."""
    does_more = any(option.startswith("-") and option not in _OF_RUNS for option in options)
    of_hydra = [one for one in overrides if one.startswith("hydra.")]
    if names_directory := any(f"{group}." in one for one in of_hydra for group in pipeline.GROUPS):
        process.prepare()  # stages are imported now
    is_whole = does_more or names_directory
    register(is_whole, _said(overrides) if is_whole else {})


def _said(overrides: Iterable[str]) -> Mapping[str, Any]:
    """What files and command say, composed without defaults; nothing where Hydra will refuse it."""
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    register(is_whole=False)
    try:
        with initialize_config_dir(version_base=None, config_dir=str(conf_folder())):
            return _mapping(OmegaConf.to_container(compose("config", list(overrides)), resolve=False))
    except Exception:
        return {}


def of_groups(said: Mapping[str, Any] = {}) -> dict[str, Any]:
    """Group -> its settings when nothing else is said, as plain dicts and lists; imports every stage.

    Args:
        said: a configuration; where a group has several classes of settings, it says which.
    """
    found = {}
    for group in pipeline.GROUPS:
        kind, values = pipeline.kind_of(group), _mapping(said.get(group))
        tags = tags_of(kind)
        known = {tags.name: values[tags.name]} if tags and tags.name in values else {}
        found[group] = as_mapping(build(kind, known, group))
    return found


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
