"""Trained parameters as release artifacts: a flat `.npz`, and a `.json` that says how to use them."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from qjrl import artifacts


def save_parameters(path: str | Path, tree: Mapping[str, Any], description: Mapping[str, Any]) -> None:
    """Writes `path`.npz and `path`.json.

    Args:
        path: without suffix.
        tree: nested dicts of arrays; names are joined by '/'.
        description: plain values: sizes, units, the network's configuration.
    """
    artifacts.write_arrays(f"{path}.npz", dict(_flat(tree)))
    artifacts.write_json(f"{path}.json", description)


def load_parameters(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Reads what `save_parameters` wrote, on the host.

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
    return tree, artifacts.load(f"{path}.json")


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}/")
        else:
            yield f"{prefix}{name}", np.asarray(value)
