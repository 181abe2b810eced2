"""A function of one sample as ONNX: traced to plain operations first, then translated by jax2onnx.

jax2onnx 0.17 replaces functions of `jax.numpy` by its own, whose rules for batches are wrong for some (`jnp.dot`), and
knows neither `polynomial` nor the gather that a batched index becomes. So the function is traced by JAX alone, with
loops unrolled and constants folded, and only the operations of that trace are handed over.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import Literal

from qjrl.deployment.functions import DeployedFunction, Precision
from qjrl.deployment.onnx_model import OPSET, quiet


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


def plain_operations(function: Callable[..., Any], arguments: list[Any]) -> Callable[..., tuple[Any, ...]]:
    """The same function as a list of operations without calls and loops, those on constants alone done beforehand."""
    with jax.disable_jit():
        traced = jax.make_jaxpr(function)(*arguments)
    return lambda *arrays: _told_apart(_evaluate(traced, arrays), arrays[0])


def _evaluate(traced: Any, arrays: tuple[Any, ...]) -> tuple[Any, ...]:
    values: dict[Any, Any] = dict(zip(traced.jaxpr.constvars, traced.consts, strict=True))
    values |= zip(traced.jaxpr.invars, arrays, strict=True)
    value_of = lambda one: one.val if isinstance(one, Literal) else values[one]  # noqa: E731
    for equation in traced.jaxpr.eqns:
        inputs = [value_of(one) for one in equation.invars]
        found = _apply(equation.primitive, inputs, equation.params)
        several = equation.primitive.multiple_results
        values |= zip(equation.outvars, found if several else [found], strict=True)
    return tuple(value_of(one) for one in traced.jaxpr.outvars)


def _told_apart(outputs: tuple[Any, ...], example: Any) -> tuple[Any, ...]:
    """The outputs with a zero of the input added to constants and repetitions: jax2onnx gives a value one name."""
    seen, distinct = set(), []
    for output in outputs:
        if not isinstance(output, Tracer) or id(output) in seen:
            output = jax.lax.add(output, jax.lax.broadcast(_zero_of(example, output.dtype), output.shape))
        seen.add(id(output))
        distinct.append(output)
    return tuple(distinct)


def _zero_of(example: Any, dtype: Any) -> Any:
    first = jax.lax.index_in_dim(jax.lax.reshape(example, (example.size,)), 0, keepdims=False)
    return jax.lax.convert_element_type(jax.lax.mul(first, jax.lax.full_like(first, 0.0)), dtype)


def _apply(primitive: Any, inputs: list[Any], parameters: dict[str, Any]) -> Any:
    if not any(isinstance(one, Tracer) for one in inputs):
        with jax.ensure_compile_time_eval():
            return primitive.bind(*inputs, **parameters)
    if primitive.name in _REWRITTEN:
        return _REWRITTEN[primitive.name](*inputs, **parameters)
    return primitive.bind(*inputs, **parameters)


def _polynomial(x: Any, *coefficients: Any, **_: Any) -> Any:
    """By Horner's rule, the lowest degree first."""
    answer = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        answer = answer * x + coefficient
    return answer


def _fixed_gather(array: Any, indices: Any, *, dimension_numbers: Any, slice_sizes: tuple[int, ...], **_: Any) -> Any:
    """A gather at one known place, which is a slice."""
    if dimension_numbers.collapsed_slice_dims or np.ndim(indices) != 1 or isinstance(indices, Tracer):
        raise NotImplementedError("gather at places that are not known beforehand")
    start = [0] * array.ndim
    for axis, place in zip(dimension_numbers.start_index_map, np.asarray(indices), strict=True):
        start[int(axis)] = int(place)
    return jax.lax.slice(array, start, [first + size for first, size in zip(start, slice_sizes, strict=True)])


_REWRITTEN: dict[str, Callable[..., Any]] = {"polynomial": _polynomial, "gather": _fixed_gather}
