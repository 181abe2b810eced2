"""Learned forward models, cable lengths -> pose: the paper's network, and the same network as a correction.

The paper's form maps scaled lengths to the pose. The corrected form works in the robot's own configuration: the nominal
one of the lengths goes in, the correction to it comes out (what joint encoders measure), and the closed-form kinematics
makes the pose of them. Sag, strand stretch and friction bend the joints; the links stay rigid, so nothing is lost, and
the network learns eight small smooth numbers of the quaternion-joint arm instead of its whole kinematics. A third form
lies between the two, to tell what comes in from what goes out: scaled lengths go in, the correction comes out.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, Range, as_mapping, build, configuration
from qjrl.learning.fitting import FitConfig, FittedNetwork, predict
from qjrl.learning.networks import FourierResidualNetwork, NetworkConfig
from qjrl.learning.parameters import load_parameters, save_parameters
from qjrl.robot.kinds import kind_of, num_coordinates
from qjrl.robot.loading import robot_hash
from qjrl.robot.verbs import Robot, cable_strokes, configuration_from_cables, forward_kinematics

PoseFunction = Callable[[jax.Array], jax.Array]


@configuration
class ForwardModelConfig:
    """Group `forward_model`. Defaults: the paper's network as a correction of the nominal bends (ours)."""

    form: Literal["paper", "corrected_from_lengths", "corrected"] = "corrected"
    """"paper": scaled lengths -> pose; "corrected": nominal configuration -> its correction, then the kinematics;
    "corrected_from_lengths": scaled lengths -> the same correction."""
    network: NetworkConfig = NetworkConfig()
    """Size of the network."""
    fit: FitConfig = FitConfig()
    """How it is fitted."""
    held_out: Annotated[float, Range(above=0.0, high=0.5)] = 0.1
    """Share of the rows that the fit never sees; errors are reported on them (ours)."""
    ensemble: Annotated[int, Range(1, 64)] = 1
    """Networks fitted together from other random starts; their mean answers, their spread says how sure it is."""


@struct.dataclass
class ForwardModel:
    """A fitted model of one robot; `pose_function` makes the plain function that solvers take."""

    fitted: FittedNetwork
    config: ForwardModelConfig = struct.field(pytree_node=False)
    sigma_factors: Any = None
    """(2,) of an ensemble: what the spreads of position and orientation are multiplied by; see `model_uncertainty`."""


def model_inputs(robot: Robot, form: str, lengths: jax.Array) -> jax.Array:
    """What enters the network, scaled to [-1, 1], from cable lengths (num_cables,) [m]."""
    if form in ("paper", "corrected_from_lengths"):
        return lengths / cable_strokes(robot)
    return (configuration_from_cables(robot, lengths) / kind_of(robot).largest(robot)).reshape(-1)


def model_pose(robot: Robot, form: str, lengths: jax.Array, answer: jax.Array) -> jax.Array:
    """Pose (9,) from the network's answer at cable lengths (num_cables,) [m]."""
    if form == "paper":
        return answer
    nominal = configuration_from_cables(robot, lengths)
    return forward_kinematics(robot, nominal + answer.reshape(nominal.shape))


def pose_function(robot: Robot, model: ForwardModel | None) -> PoseFunction:
    """The plain function lengths (num_cables,) [m] -> pose (9,); without a model, the nominal closed form."""
    if model is None:
        return lambda lengths: forward_kinematics(robot, configuration_from_cables(robot, lengths))
    form, network = model.config.form, make_network(robot, model.config)

    def pose(lengths: jax.Array) -> jax.Array:
        answer = predict(network, model.fitted, model_inputs(robot, form, lengths))
        return model_pose(robot, form, lengths, answer)

    return pose


def make_network(robot: Robot, config: ForwardModelConfig) -> FourierResidualNetwork:
    """The network of a configuration, untrained."""
    return FourierResidualNetwork(config.network, 9 if config.form == "paper" else num_coordinates(robot))


def save_forward_model(path: Path, robot: Robot, model: ForwardModel) -> None:
    """Write `path`.npz (parameters, normaliser) and `path`.json (what they mean)."""
    tree = {
        "parameters": jax.tree.map(np.asarray, model.fitted.parameters),
        "output_mean": np.asarray(model.fitted.output_mean),
        "output_std": np.asarray(model.fitted.output_std),
    }
    if model.sigma_factors is not None:
        tree["sigma_factors"] = np.asarray(model.sigma_factors)
    save_parameters(path, tree, {"robot_hash": robot_hash(robot), "config": as_mapping(model.config)})


def load_forward_model(path: Path, robot: Robot) -> ForwardModel:
    """Read what `save_forward_model` wrote.

    Raises:
        ArtifactError: missing, truncated, or of another robot.
    """
    names = ("parameters", "output_mean", "output_std")
    tree, description = load_parameters(path, {"robot_hash": str, "config": dict}, names)
    if description["robot_hash"] != robot_hash(robot):
        raise ArtifactError(f"{path}.json: belongs to another robot than {robot.name}")
    try:
        config = build(ForwardModelConfig, description["config"], "config")
    except ConfigError as error:
        raise ArtifactError(f"{path}.json: {error}") from error
    sigma_factors = tree.get("sigma_factors")
    fitted = FittedNetwork(
        **{name: jax.tree.map(jnp.asarray, tree[name]) for name in names}, num_members=config.ensemble
    )
    return ForwardModel(fitted, config, sigma_factors)


def load_pose_function(path: Path, robot: Robot) -> PoseFunction:
    """The plain function lengths (num_cables,) [m] -> pose (9,) of a model on disk; raises as `load_forward_model`."""
    return pose_function(robot, load_forward_model(path, robot))
