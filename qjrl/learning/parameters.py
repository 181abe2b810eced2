"""Trained parameters as release artifacts: a flat `.npz`, and a `.json` that says how to use them."""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qjrl import artifacts
from qjrl.records import Kinds, check_names


def save_parameters(path: str | Path, tree: Mapping[str, Any], description: Mapping[str, Any]) -> None:
    """Writes `path`.npz and `path`.json.

    Args:
        path: without suffix.
        tree: nested dicts of arrays; names are joined by '/'.
        description: plain values: sizes, units, the network's configuration.
    """
    artifacts.write_arrays(f"{path}.npz", dict(_flat(tree)))
    artifacts.write_json(f"{path}.json", description)


def load_parameters(
    path: str | Path, kinds: Kinds | None = None, names: Collection[str] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Reads what `save_parameters` wrote, on the host.

    Args:
        kinds: of the description, what is asked by key; see `check_record`.
        names: at the top of the tree that must be there.
    Raises:
        ArtifactError: a file is missing or damaged, or lacks one of them.
    Returns:
        The nested dict of numpy arrays, and the description.
    """
    tree: dict[str, Any] = {}
    for name, array in artifacts.load(f"{path}.npz").items():
        *folders, leaf = name.split("/")
        node = tree
        for folder in folders:
            node = node.setdefault(folder, {})
        node[leaf] = array
    check_names(f"{path}.npz", tree, names, "the parameters of a network")
    return tree, artifacts.read_record(f"{path}.json", kinds or {}, "the description of a network")


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}/")
        else:
            yield f"{prefix}{name}", np.asarray(value)
