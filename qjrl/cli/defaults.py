"""The defaults of the dataclasses, the first entry of `conf/config.yaml`: what a file or the command says comes on top.

A run is told only which groups there are, so that no stage is imported before it: what nobody sets gets its default where a
stage's Config is built, and what somebody sets is checked there. Whoever prints the configuration is told all of it.
"""

from collections.abc import Iterable
from typing import Any

from qjrl import pipeline
from qjrl.cli import process
from qjrl.config import as_mapping

NAME = "defaults"
"""Of the entry."""
_OF_RUNS = {"--multirun", "-m", "--run", "-r"}


def register(is_whole: bool) -> None:
    """Makes the entry known to Hydra.

    Args:
        is_whole: with every key. Otherwise the groups are empty, and open to any key.
    """
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf

    groups = of_groups() if is_whole else {group: {} for group in pipeline.GROUPS}
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
    register(does_more or names_directory)


def of_groups() -> dict[str, Any]:
    """Group -> its settings when nothing is said, as plain dicts and lists; imports every stage."""
    return {group: as_mapping(pipeline.kind_of(group)()) for group in pipeline.GROUPS}
