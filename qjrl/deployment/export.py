"""Forward model and inverse kinematics as files for a controller: made in memory, checked, and only then written."""

import dataclasses
import hashlib
import importlib.metadata
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError
from qjrl.deployment import onnx_model, stablehlo
from qjrl.deployment.compact_ik import CompactIKConfig, compact_ik
from qjrl.deployment.contract import FORMAT, function_contract, robot_contract
from qjrl.deployment.functions import (
    DeployedFunction,
    Precision,
    SolveFunction,
    forward_function,
    inverse_function,
)
from qjrl.deployment.latency import measure_latency
from qjrl.deployment.parity import (
    LoadedFunction,
    ParityConfig,
    Reference,
    check_forward,
    check_inverse,
    make_reference,
)
from qjrl.keys import seed_for
from qjrl.provenance import read_provenance
from qjrl.robot import in_precision
from qjrl.robot.forward_model import pose_function
from qjrl.robot.model_errors import pose_errors
from qjrl.robot.model_fitting import settled_split
from qjrl.robot.model_kind import FittedModel
from qjrl.robot.network_model import NetworkModel
from qjrl.robot.verbs import Robot

log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class ExportConfig:
    """Group `export`; all values ours."""

    platforms: tuple[Literal["cpu", "cuda", "rocm", "tpu"], ...] = ("cpu", "cuda")
    """Where the StableHLO files shall run."""
    precision: Precision = "float32"
    """Of what goes in and out and of the kinematics; the network itself computes in float32."""
    onnx: bool = True
    """Write the forward model as ONNX too, where the extra [onnx] is installed."""
    ik: CompactIKConfig = CompactIKConfig()
    """The solver in the file."""
    parity: ParityConfig = ParityConfig()
    """What is compared with the package before a file is written."""

    def __post_init__(self):
        if not self.platforms:
            raise ConfigError("platforms: got [], allowed: at least one of cpu, cuda, rocm, tpu")
        if (
            self.onnx and self.precision == "float64"
        ):  # jax2onnx makes a float32 network within it a file that does not load
            raise ConfigError("precision: got float64 with onnx true, allowed: float32, or float64 with onnx false")


@dataclasses.dataclass(frozen=True)
class Export:
    """Checked files, not yet written."""

    files: dict[str, bytes]
    functions: dict[str, dict[str, Any]]
    """Their part of the contract."""
    metrics: dict[str, Any]
    """Parity, accuracy, latency."""


def held_out_rows(robot: Robot, dataset: Path, forward_model: Path, config: Any) -> dict[str, np.ndarray]:
    """The settled rows that the fit in `forward_model` never saw.

    Args:
        config: of the fit.
    Raises:
        ArtifactError: the data set is not the one that was fitted, or as `settled_rows`.
    """
    fitted_on = (artifacts.done_marker(forward_model) or {}).get("inputs", {}).get("sample")
    if fitted_on != (artifacts.done_marker(dataset) or {}).get("output_hash"):
        raise ArtifactError(
            f"{forward_model}: was fitted to another data set than {dataset}; run stages=[forward_model,export]"
        )
    seed = read_provenance(forward_model)["seed"]
    return settled_split(robot, artifacts.load(dataset), config.held_out, seed)[1]


def export_controller(
    robot: Robot,
    model: FittedModel,
    config: ExportConfig,
    held_out: Mapping[str, np.ndarray],
    seed: int,
    solve: SolveFunction | None = None,
) -> Export:
    """Make the files of a robot and its model and check every one.

    Args:
        held_out: columns of rows that the fit never saw.
        seed: of the rows that are compared and of the solver's starts.
        solve: inverse kinematics to export, target (9,) -> outputs; default: `compact_ik` as configured.
    Raises:
        ParityError: a file computes something else than the package.
    """
    inner, live = in_precision(robot, config.precision), pose_function(robot, model)
    forward = forward_function(robot, model, config.precision)
    solve = solve or compact_ik(inner, pose_function(inner, model), config.ik, seed)
    inverse = inverse_function(robot, solve)
    files = _make_files(robot, model, config, forward, inverse)
    calls: dict[str, LoadedFunction] = {
        name: (onnx_model if name == ONNX_FILE else stablehlo).load(content) for name, content in files.items()
    }
    reference = make_reference(
        robot, live, held_out, config.precision, config.parity, seed_for(seed, "rows of the parity check")
    )
    package = jax.jit(jax.vmap(solve))
    checks = {
        name: check_inverse(name, call, package, reference)
        if name == INVERSE_FILE
        else check_forward(name, call, reference)
        for name, call in calls.items()
    }
    functions = {
        forward.name: _described(forward, config, {name: files[name] for name in files if name != INVERSE_FILE}),
        inverse.name: _described(inverse, config, {INVERSE_FILE: files[INVERSE_FILE]}),
    }
    metrics = {
        "parity": checks,
        "accuracy": _accuracy(calls[FORWARD_FILE], held_out, config),
        "latency": _latency(calls, reference),
    }
    return Export(files, functions, metrics)


def contract_of(export: Export, robot: Robot, precision: Precision, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """What `contract.json` says beside the files."""
    about = {
        "format": FORMAT,
        "precision": precision,
        "functions": export.functions,
        "versions": provenance["versions"] | (onnx_model.versions() if ONNX_FILE in export.files else {}),
        "code": provenance["code"],
        "config_hash": provenance["config_hash"],
        "inputs": provenance["inputs"],
    }
    return about | robot_contract(robot) | export.metrics


def _make_files(
    robot: Robot, model: FittedModel, config: ExportConfig, forward: DeployedFunction, inverse: DeployedFunction
) -> dict[str, bytes]:
    files = {
        FORWARD_FILE: stablehlo.serialise(forward, config.precision, config.platforms),
        INVERSE_FILE: stablehlo.serialise(inverse, config.precision, config.platforms),
    }
    if isinstance(model, NetworkModel):
        if _makes_onnx(config):
            files[ONNX_FILE] = onnx_model.onnx_bytes(robot, model, forward, config.precision)
    elif config.onnx:
        log.warning("export: no ONNX file, the model is of the kind %s, allowed: network", model.config.kind)
    return files


def _accuracy(call: LoadedFunction, held_out: Mapping[str, np.ndarray], config: ExportConfig) -> dict[str, Any]:
    """Errors of the exported forward model on all held-out rows."""
    poses = np.asarray(call(held_out["cable_lengths"].astype(config.precision))["pose"], np.float64)
    return {"held_out_rows": len(poses), **pose_errors(poses, held_out["pose"])}


def _latency(calls: Mapping[str, LoadedFunction], reference: Reference) -> dict[str, dict[str, float]]:
    """Of every file, for one row at a time."""
    rows = {name: reference.targets if name == INVERSE_FILE else reference.lengths for name in calls}
    return {name: measure_latency(call, rows[name][0].astype(reference.precision)) for name, call in calls.items()}


def _makes_onnx(config: ExportConfig) -> bool:
    """Whether to, and where the extra is missing, the line that says how."""
    missing = onnx_model.missing_packages() if config.onnx else []
    if missing:
        log.warning(
            "export: no ONNX file, %s is not installed: pip install 'qjrl[onnx]' and run again",
            ", ".join(missing),
        )
    return config.onnx and not missing


def _described(deployed: DeployedFunction, config: ExportConfig, files: Mapping[str, bytes]) -> dict[str, Any]:
    kinds = {".stablehlo": _about_stablehlo(config), ".onnx": {"format": "ONNX", "opset": onnx_model.OPSET}}
    listed = {
        name: kinds[Path(name).suffix] | {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        for name, content in files.items()
    }
    return function_contract(deployed, config.precision, listed)


def _about_stablehlo(config: ExportConfig) -> dict[str, Any]:
    return {
        "format": "StableHLO, jax.export",
        "platforms": list(config.platforms),
        "made_by_jax": importlib.metadata.version("jax"),
    }


FORWARD_FILE = "forward_model.stablehlo"
INVERSE_FILE = "inverse_kinematics.stablehlo"
ONNX_FILE = "forward_model.onnx"
