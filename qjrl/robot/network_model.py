"""The Fourier residual network as a forward model: the paper's form, and the same network as a correction."""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.config import NotIdentity, Range, configuration
from qjrl.learning.fitting import FitConfig, FittedNetwork, predict
from qjrl.learning.networks import FourierResidualNetwork, NetworkConfig
from qjrl.robot.model_coordinates import Form, model_inputs, model_pose, num_answers
from qjrl.robot.model_kind import num_numbers
from qjrl.robot.verbs import Robot

NAMES = ("parameters", "output_mean", "output_std")
"""Of what a file must hold."""


@configuration
class NetworkModelConfig:
    """Group `forward_model`. Defaults: the paper's network as a correction of the nominal bends (ours)."""

    # One value says nothing beyond the class, and no other kind has these keys: runs from before it was said stay valid.
    kind: Annotated[Literal["network"], NotIdentity()] = dataclasses.field(default="network", kw_only=True)
    """Of the model; meant where nothing is said."""
    form: Form = "corrected"
    """What goes in and comes out, see `model_coordinates.Form`."""
    network: NetworkConfig = NetworkConfig()
    """Size of the network."""
    fit: FitConfig = FitConfig()
    """How it is fitted."""
    held_out: Annotated[float, Range(above=0.0, high=0.5)] = 0.1
    """Share of the rows that the fit never sees; errors are reported on them (ours)."""
    ensemble: Annotated[int, Range(1, 64)] = 1
    """Networks fitted together from other random starts; their mean answers, their spread says how sure it is."""


@struct.dataclass
class NetworkModel:
    """A fitted network, or an ensemble of them, of one robot."""

    fitted: FittedNetwork
    config: NetworkModelConfig = struct.field(pytree_node=False)
    sigma_factors: Any = None
    """(2,) of an ensemble: what the spreads of position and orientation are multiplied by; see `model_uncertainty`."""


@struct.dataclass(eq=False)
class NetworkPose:
    """A fitted network on its robot."""

    robot: Any
    fitted: Any
    form: Form = struct.field(pytree_node=False)
    network: FourierResidualNetwork = struct.field(pytree_node=False)

    def __call__(self, lengths: jax.Array) -> jax.Array:
        """Pose (9,) at cable lengths (num_cables,) [m]."""
        answer = predict(self.network, self.fitted, model_inputs(self.robot, self.form, lengths))
        return model_pose(self.robot, self.form, lengths, answer)


def on_robot(robot: Robot, model: NetworkModel) -> NetworkPose:
    """The model as it is called. How it was fitted is no part of it: another fit of the same size shares its programs."""
    return NetworkPose(robot, model.fitted, model.config.form, make_network(robot, model.config))


def make_network(robot: Robot, config: NetworkModelConfig) -> FourierResidualNetwork:
    """The network of a configuration, untrained."""
    return FourierResidualNetwork(config.network, num_answers(robot, config.form))


def to_arrays(model: NetworkModel) -> dict[str, Any]:
    """Parameters and normaliser, and what the spread of an ensemble is multiplied by."""
    arrays = {name: jax.tree.map(np.asarray, getattr(model.fitted, name)) for name in NAMES}
    return arrays if model.sigma_factors is None else arrays | {"sigma_factors": np.asarray(model.sigma_factors)}


def from_arrays(config: NetworkModelConfig, arrays: Mapping[str, Any]) -> NetworkModel:
    """The model of what `to_arrays` gave."""
    fitted = {name: jax.tree.map(jnp.asarray, arrays[name]) for name in NAMES}
    return NetworkModel(FittedNetwork(**fitted, num_members=config.ensemble), config, arrays.get("sigma_factors"))


def num_parameters(model: NetworkModel) -> int:
    """Of the network, of all members of an ensemble."""
    return num_numbers(model.fitted.parameters)
