"""A function of one sample as ONNX: traced to plain operations first, then translated by jax2onnx; read by onnxruntime."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from qjrl.deployment.functions import DeployedFunction, Precision
from qjrl.deployment.onnx_model import OPSET, quiet
from qjrl.deployment.plain_operations import plain_operations


def onnx_bytes(deployed: DeployedFunction, precision: Precision) -> bytes:
    """The ONNX file of a function, without a batch axis."""
    import jax2onnx

    arguments = [jax.ShapeDtypeStruct(port.shape, port.dtype or precision) for port in deployed.inputs]
    names = [port.name for port in deployed.outputs]

    def listed(*arrays: Any) -> list[Any]:
        outputs = deployed.function(*arrays)
        return [outputs[name] for name in names]

    with jax.enable_x64(precision == "float64"), quiet("onnx_ir"):
        graph: Any = jax2onnx.to_onnx(
            plain_operations(listed, arguments),
            arguments,
            model_name=deployed.name,
            opset=OPSET,
            input_names=[port.name for port in deployed.inputs],
            output_names=names,
            enable_double_precision=precision == "float64",
        )
    return graph.SerializeToString()


def load(content: bytes) -> Callable[..., dict[str, np.ndarray]]:
    """The function in a file, as a user of the file gets it: arrays in the order of its inputs -> outputs by name."""
    import onnxruntime

    options: Any = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    session: Any = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    inputs, outputs = [port.name for port in session.get_inputs()], [port.name for port in session.get_outputs()]

    def call(*arrays: Any) -> dict[str, np.ndarray]:
        fed = {name: np.asarray(array) for name, array in zip(inputs, arrays, strict=True)}
        return dict(zip(outputs, session.run(outputs, fed), strict=True))

    return call
