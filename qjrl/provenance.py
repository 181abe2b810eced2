"""Where a result comes from: configuration, robot, code, packages, seed, hardware. No host name, no places on disk."""

import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

from qjrl import artifacts
from qjrl.cores import usable_cores

PACKAGES = (
    "qjrl",
    "jax",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "brax",
    "flax",
    "optax",
    "orbax-checkpoint",
    "numpy",
    "scipy",
    "hydra-core",
)
"""Those that a number may depend on."""


def provenance(config: Any, seed: int | None, robot_hash: str | None) -> dict[str, Any]:
    """The record beside every artifact.

    Args:
        config: the resolved configuration as plain dicts and lists.
        seed: the seed that the configuration holds, if it holds one.
        robot_hash: hash of the robot the artifact belongs to.
    """
    return {
        "config": _without_places(config),
        "config_hash": artifacts.hash_of(config),
        "robot_hash": robot_hash,
        "seed": seed,
        "code": _commit(),
        "versions": _versions(),
        "hardware": _hardware(),
    }


def read_provenance(directory: str | Path) -> dict[str, Any]:
    """The record beside an artifact.

    Raises:
        ArtifactError: missing or damaged.
    """
    kinds = {"config_hash": str, "robot_hash": str | None, "seed": int | None, "config": dict}
    return artifacts.read_record(Path(directory) / artifacts.PROVENANCE, kinds, "a provenance")


def _without_places(value: Any) -> Any:
    """Absolute paths reduced to the file name: they say nothing to anybody else."""
    if isinstance(value, dict):
        return {key: _without_places(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_places(item) for item in value]
    return Path(value).name if isinstance(value, (str, Path)) and Path(value).is_absolute() else value


def _commit() -> dict[str, Any] | None:
    """Commit of the checkout this package runs from, None when it was installed from a wheel."""
    root = Path(__file__).parent.parent
    if not (root / ".git").exists():
        return None
    try:
        changes = _git(root, "status", "--porcelain", "--untracked-files=no", "--", "qjrl", "conf")
        return {"commit": _git(root, "rev-parse", "HEAD"), "modified": bool(changes)}
    except (OSError, subprocess.SubprocessError):
        return None


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-C", str(root), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=10).stdout.strip()


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def _hardware() -> dict[str, Any]:
    return {
        "cpu": _cpu_model(),
        "cores": usable_cores(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "gpu": _gpu(),
    }


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()


def _gpu() -> str | None:
    """Model of the first GPU that JAX uses; JAX is not imported only to ask."""
    if "jax" not in sys.modules:
        return None
    devices = sys.modules["jax"].local_devices()
    return devices[0].device_kind if devices[0].platform == "gpu" else None
