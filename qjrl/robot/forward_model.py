"""Forward models, cable lengths -> pose: those on disk, and as they are called. What there is: `model_kinds`."""

from pathlib import Path
from typing import Any

from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, as_mapping, build
from qjrl.learning.parameters import load_parameters, save_parameters
from qjrl.records import check_names
from qjrl.robot.loading import robot_hash
from qjrl.robot.model_coordinates import model_inputs, model_pose
from qjrl.robot.model_kind import FittedModel
from qjrl.robot.model_kinds import MODEL_KINDS, ModelConfig, model_kind_of
from qjrl.robot.network_model import NetworkModel, NetworkModelConfig, make_network
from qjrl.robot.pose_model import ClosedForm, PoseFunction
from qjrl.robot.verbs import Robot

# The default kind by its shorter names.
ForwardModelConfig = NetworkModelConfig
ForwardModel = NetworkModel

__all__ = [
    "ForwardModel",
    "ForwardModelConfig",
    "PoseFunction",
    "load_forward_model",
    "load_pose_function",
    "make_network",
    "model_inputs",
    "model_pose",
    "pose_function",
    "save_forward_model",
]


def pose_function(robot: Robot, model: FittedModel | None) -> PoseFunction:
    """The model on a robot, a pytree that is called: lengths (num_cables,) [m] -> pose (9,); None: the nominal closed form."""
    return ClosedForm(robot) if model is None else model_kind_of(model).on_robot(robot, model)


def save_forward_model(path: Path, robot: Robot, model: FittedModel) -> None:
    """Write `path`.npz (its numbers) and `path`.json (what they mean)."""
    description = {"robot_hash": robot_hash(robot), "config": as_mapping(model.config)}
    save_parameters(path, model_kind_of(model).to_arrays(model), description)


def load_forward_model(path: Path, robot: Robot) -> Any:
    """Read what `save_forward_model` wrote; a file that names no kind holds a network.

    Raises:
        ArtifactError: missing, truncated, or of another robot.
    """
    arrays, description = load_parameters(path, {"robot_hash": str, "config": dict})
    if description["robot_hash"] != robot_hash(robot):
        raise ArtifactError(f"{path}.json: belongs to another robot than {robot.name}")
    one_of_all: Any = ModelConfig
    try:
        config = build(one_of_all, description["config"], "config")
    except ConfigError as error:
        raise ArtifactError(f"{path}.json: {error}") from error
    kind = MODEL_KINDS[config.kind]
    check_names(f"{path}.npz", arrays, kind.names, f"the parameters of a {config.kind}")
    return kind.from_arrays(config, arrays)


def load_pose_function(path: Path, robot: Robot) -> PoseFunction:
    """The model on disk as `pose_function` gives it; raises as `load_forward_model`."""
    return pose_function(robot, load_forward_model(path, robot))
