"""Stage `export`: forward model and inverse kinematics as files that run without qjrl, and the contract beside them."""

import dataclasses
from pathlib import Path

from qjrl import progress
from qjrl.deployment import onnx_model
from qjrl.deployment.export import ExportConfig, contract_of, export_controller, held_out_rows
from qjrl.provenance import read_provenance
from qjrl.report.output import Output
from qjrl.robot import robot_from_mapping
from qjrl.robot.forward_model import load_forward_model
from qjrl.stage_config import RobotStageConfig


@dataclasses.dataclass(frozen=True)
class Config(RobotStageConfig):
    needs = ("interface",)

    export: ExportConfig

    @property
    def packages(self) -> dict[str, str]:
        """Once the extra is installed, the same command writes what is missing."""
        return onnx_model.missing_for(self.export.onnx)


def run(config: Config, inputs: dict[str, Path], out: Path) -> Output:
    """`*.stablehlo`, `forward_model.onnx`, `contract.json` and `metrics.json`, or nothing if a check fails."""
    robot = robot_from_mapping(config.robot)
    model = load_forward_model(inputs["forward_model"] / "model", robot)
    held_out = held_out_rows(robot, inputs["sample"], inputs["forward_model"], model.config)
    with progress.compiling("the exported functions and their checks"):
        export = export_controller(robot, model, config.export, held_out, config.seed)
    return Output(
        export.metrics,
        records={"contract": contract_of(export, robot, config.export.precision, read_provenance(out))},
        files=export.files,
        shown=[f"export: {_line(file, report)}" for file, report in export.metrics["parity"].items()],
    )


def _line(file: str, report: dict) -> str:
    """The worst numbers of a file over its sets of rows."""
    worst = lambda key: max(rows[key] for rows in report.values())  # noqa: E731
    if "position_difference" in report["random"]:
        return f"{file} is within {1e6 * worst('position_difference'):.2g} µm and {worst('orientation_difference'):.2g} rad"
    shares = ", ".join(f"{rows['converged_share']:.1%} of {name}" for name, rows in report.items())
    return f"{file} solves {shares} targets and states its errors to {1e6 * worst('position_error_difference'):.2g} µm"
