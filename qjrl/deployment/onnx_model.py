"""The forward model as ONNX, by jax2onnx (the extra `onnx`), and read back by onnxruntime."""

import importlib.metadata
import importlib.util
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np

from qjrl.deployment.functions import DeployedFunction, Precision
from qjrl.learning.fitting import predict
from qjrl.robot import in_precision
from qjrl.robot.kinds import verb
from qjrl.robot.model_coordinates import model_inputs
from qjrl.robot.network_model import NetworkModel, make_network
from qjrl.robot.verbs import Robot, configuration_from_cables

PACKAGES = ("jax2onnx", "onnx", "onnxruntime")
OPSET = 23


def missing_packages() -> list[str]:
    """What the extra would install and this environment lacks."""
    return [name for name in PACKAGES if importlib.util.find_spec(name) is None]


def missing_for(onnx: bool) -> dict[str, str]:
    """What keeps the ONNX files that are asked for from being written: part of the identity of a stage that would write them."""
    missing = missing_packages() if onnx else []
    return {"missing for ONNX": ", ".join(missing)} if missing else {}


def versions() -> dict[str, str]:
    """Of the packages that made the file."""
    return {name: importlib.metadata.version(name) for name in PACKAGES}


def onnx_bytes(robot: Robot, model: NetworkModel, deployed: DeployedFunction, precision: Precision) -> bytes:
    """The ONNX file of a forward model: (batch, num_cables) [m] -> (batch, 9)."""
    import jax2onnx

    function = _batched_forward_model(in_precision(robot, precision), model)
    with jax.disable_jit(), quiet("onnx_ir"):  # jax2onnx 0.17 cannot enter the nested jits of jax 0.12
        graph: Any = jax2onnx.to_onnx(
            function,
            [("batch", *port.shape) for port in deployed.inputs],
            model_name=deployed.name,
            opset=OPSET,
            input_names=[port.name for port in deployed.inputs],
            output_names=[port.name for port in deployed.outputs],
            enable_double_precision=precision == "float64",
        )
    return graph.SerializeToString()


def load(content: bytes) -> Callable[[Any], dict[str, np.ndarray]]:
    """The function in a file, as a user of the file gets it."""
    import onnxruntime

    session: Any = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    name, outputs = session.get_inputs()[0].name, [port.name for port in session.get_outputs()]
    return lambda rows: dict(zip(outputs, session.run(outputs, {name: np.asarray(rows)}), strict=True))


def _batched_forward_model(robot: Robot, model: NetworkModel) -> Callable[[jax.Array], jax.Array]:
    """`NetworkPose` over a batch, without what jax2onnx cannot translate: a vmapped dense layer, a scan over joints."""
    form, network, plain_poses = model.config.form, make_network(robot, model.config), verb(robot, "plain_poses")

    def poses(lengths: jax.Array) -> jax.Array:
        answers = predict(network, model.fitted, jax.vmap(lambda row: model_inputs(robot, form, row))(lengths))
        if form == "paper":
            return answers.astype(lengths.dtype)
        nominal = jax.vmap(lambda row: configuration_from_cables(robot, row))(lengths)
        return plain_poses(robot, nominal + answers.astype(lengths.dtype).reshape(nominal.shape))

    return poses


@contextmanager
def quiet(name: str) -> Iterator[None]:
    """onnx_ir warns of every constant that has a shape and no type yet; the checked file has all types."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)
