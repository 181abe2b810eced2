"""The residual controller as files: made in memory, checked over whole episodes, and only then written."""

import dataclasses
import hashlib
import importlib.metadata
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import jax

from qjrl import progress
from qjrl.config import ConfigError, Range, configuration
from qjrl.deployment import onnx_controller, onnx_model, stablehlo
from qjrl.deployment.contract import FORMAT, function_contract, robot_contract
from qjrl.deployment.controller import PROTOCOL, DeployedController
from qjrl.deployment.controller_parity import FileController, Rehearsal, check_controller
from qjrl.deployment.functions import DeployedFunction, Precision
from qjrl.robot.verbs import Robot


@configuration
class ControllerExportConfig:
    """Keys of group `deploy` about the files."""

    platforms: tuple[Literal["cpu", "cuda", "rocm", "tpu"], ...] = ("cpu", "cuda")
    """Where the StableHLO files shall run."""
    precision: Precision = "float32"
    """Of what goes in and out and of what is computed; the network computes in float32."""
    onnx: bool = True
    """Write ONNX files too, where the extra [onnx] is installed."""
    parity: Annotated[float, Range(above=0.0)] = 1e-5
    """Largest difference of a command from the package's, in double precision, over an episode [m]."""

    def __post_init__(self):
        if not self.platforms:
            raise ConfigError("platforms: got [], allowed: at least one of cpu, cuda, rocm, tpu")


@dataclasses.dataclass(frozen=True)
class ControllerExport:
    """Checked files, not yet written."""

    deployed: DeployedController
    files: dict[str, bytes]
    parity: dict[str, Any]
    """File of the step -> measured difference."""
    controllers: dict[str, FileController]
    """File of the step -> the files, read back and compiled."""


def export_files(
    robot: Robot, deployed: DeployedController, config: ControllerExportConfig, rehearsal: Rehearsal
) -> ControllerExport:
    """Make the files and check them.

    Raises:
        ParityError: a file commands something else than the package.
    """
    with_onnx = config.onnx and not onnx_model.missing_packages()
    files: dict[str, bytes] = {}
    controllers: dict[str, FileController] = {}
    for suffix in ("stablehlo", "onnx") if with_onnx else ("stablehlo",):
        contents = [_file(function, suffix, config) for function in (deployed.begin, deployed.step)]
        files |= {
            f"{one.name}.{suffix}": made for one, made in zip((deployed.begin, deployed.step), contents, strict=True)
        }
        load = stablehlo.load if suffix == "stablehlo" else onnx_controller.load
        begin, step = map(load, contents)
        is_batched = suffix == "stablehlo"
        controllers[f"{deployed.step.name}.{suffix}"] = FileController(
            deployed, begin, step, config.precision, is_batched
        )
    parity = {file: check_controller(file, one, rehearsal, config.parity) for file, one in controllers.items()}
    return ControllerExport(deployed, files, parity, controllers)


def controller_contract(
    export: ControllerExport,
    robot: Robot,
    config: ControllerExportConfig,
    settings: Mapping[str, Any],
    provenance: Mapping[str, Any],
) -> dict[str, Any]:
    """What `contract.json` says beside the files.

    Args:
        settings: what the controller was configured with, for the reader of the contract.
    """
    functions = (export.deployed.begin, export.deployed.step)
    made_by = onnx_model.versions() if any(name.endswith("onnx") for name in export.files) else {}
    about = {
        "format": FORMAT,
        "precision": config.precision,
        "protocol": PROTOCOL,
        "controller": dict(settings),
        "functions": {one.name: _described(one, export.files, config) for one in functions},
        "parity": export.parity,
        "versions": provenance["versions"] | made_by,
        "code": provenance["code"],
        "config_hash": provenance["config_hash"],
        "inputs": provenance["inputs"],
    }
    return about | robot_contract(robot)


def _file(function: DeployedFunction, suffix: str, config: ControllerExportConfig) -> bytes:
    with progress.compiling(f"{function.name}.{suffix}"):
        if suffix == "onnx":
            return onnx_controller.onnx_bytes(function, config.precision)
        with jax.enable_x64(config.precision == "float64"):
            return stablehlo.serialise(function, config.precision, config.platforms)


def _described(
    function: DeployedFunction, files: Mapping[str, bytes], config: ControllerExportConfig
) -> dict[str, Any]:
    kinds: dict[str, dict[str, Any]] = {
        "stablehlo": {
            "format": "StableHLO, jax.export",
            "platforms": list(config.platforms),
            "made_by_jax": importlib.metadata.version("jax"),
            "batch": "every array has a leading batch axis of any size",
        },
        "onnx": {
            "format": "ONNX",
            "opset": onnx_model.OPSET,
            "batch": "no batch axis: leave `batch` out of the shapes",
        },
    }
    listed = {
        name: kinds[name.rsplit(".", 1)[1]] | {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        for name, content in files.items()
        if name.rsplit(".", 1)[0] == function.name
    }
    described = function_contract(function, config.precision, listed)
    return described | {"batch": "as each file says"}
