"""A function as a list of operations that jax2onnx translates rightly.

jax2onnx 0.17 replaces functions of `jax.numpy` by its own, whose rules for batches are wrong for some (`jnp.dot`), takes
a transposed factor of a product as it stands, and knows neither `polynomial` nor the gather that a batched index
becomes. So the function is traced by JAX alone, calls are entered, loops over rows unrolled and constants folded, and
only the operations of that trace are handed over.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import Literal


def plain_operations(function: Callable[..., Any], arguments: list[Any]) -> Callable[..., tuple[Any, ...]]:
    """The same function as a list of operations without calls and loops over rows, those on constants alone done beforehand."""
    traced = jax.make_jaxpr(function)(*arguments)
    return lambda *arrays: _told_apart(_evaluate(traced, arrays), arrays[0])


def _evaluate(traced: Any, arrays: Sequence[Any]) -> tuple[Any, ...]:
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
    if primitive.name in _CALLS:
        return _evaluate(parameters[_CALLS[primitive.name]], inputs)
    if primitive.name in _REWRITTEN:
        return _REWRITTEN[primitive.name](*inputs, **parameters)
    return primitive.bind(*inputs, **parameters)


def _polynomial(x: Any, *coefficients: Any, **_: Any) -> Any:
    """By Horner's rule, the lowest degree first."""
    answer = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        answer = answer * x + coefficient
    return answer


def _dot_general(left: Any, right: Any, *, dimension_numbers: Any, preferred_element_type: Any, **_: Any) -> Any:
    """As a product of matrices, rows times columns."""
    (left_summed, right_summed), (left_batch, right_batch) = dimension_numbers
    left_free = [axis for axis in range(left.ndim) if axis not in (*left_summed, *left_batch)]
    right_free = [axis for axis in range(right.ndim) if axis not in (*right_summed, *right_batch)]
    batch = [left.shape[axis] for axis in left_batch]
    rows, columns = [left.shape[axis] for axis in left_free], [right.shape[axis] for axis in right_free]
    summed = math.prod(left.shape[axis] for axis in left_summed)
    left = jax.lax.transpose(left, (*left_batch, *left_free, *left_summed))
    right = jax.lax.transpose(right, (*right_batch, *right_summed, *right_free))
    product = jax.lax.dot_general(
        jax.lax.reshape(left, (*batch, math.prod(rows), summed)),
        jax.lax.reshape(right, (*batch, summed, math.prod(columns))),
        (((len(batch) + 1,), (len(batch),)), (tuple(range(len(batch))), tuple(range(len(batch))))),
        preferred_element_type=preferred_element_type,
    )
    return jax.lax.reshape(product, (*batch, *rows, *columns))


def _scan(*inputs: Any, jaxpr: Any, length: int, reverse: bool, ft_in: Any, **_: Any) -> list[Any]:
    """Unrolled where it goes over rows, so that their places are known; kept where it only repeats."""
    constants, carry, rows = (list(part) for part in ft_in.update(inputs).unpack())

    def body(carry: Sequence[Any], row: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        outputs = list(_evaluate(jaxpr, [*constants, *carry, *row]))
        return outputs[: len(carry)], outputs[len(carry) :]

    if not rows and len(jaxpr.out_avals) == len(carry):
        return jax.lax.scan(lambda carry, _: (body(carry, [])[0], None), carry, None, length)[0]
    found = []
    for index in reversed(range(length)) if reverse else range(length):
        carry, outputs = body(carry, [_row(array, index) for array in rows])
        found.append(outputs)
    stacked = zip(*(found[::-1] if reverse else found), strict=True)
    return [*carry, *(jnp.stack(one) for one in stacked)]


def _row(array: Any, index: int) -> Any:
    with contextlib.nullcontext() if isinstance(array, Tracer) else jax.ensure_compile_time_eval():
        return jax.lax.index_in_dim(jnp.asarray(array), index, keepdims=False)


def _fixed_gather(
    array: Any, indices: Any, *, dimension_numbers: Any, slice_sizes: tuple[int, ...], mode: Any, **_: Any
) -> Any:
    """A gather at known places: slices, put side by side."""
    if isinstance(indices, Tracer) or dimension_numbers.operand_batching_dims:
        raise NotImplementedError("gather at places that are not known beforehand")
    indices, collapsed = np.asarray(indices), tuple(map(int, dimension_numbers.collapsed_slice_dims))
    last = np.asarray(array.shape) - slice_sizes
    slices = []
    for place in indices.reshape(-1, indices.shape[-1]):
        start = np.zeros(array.ndim, int)
        start[list(dimension_numbers.start_index_map)] = place
        if mode != jax.lax.GatherScatterMode.CLIP and np.any((start < 0) | (start > last)):
            raise NotImplementedError(f"gather at {start}, outside of {array.shape}")
        start = np.clip(start, 0, last)
        part = jax.lax.slice(array, start.tolist(), (start + slice_sizes).tolist())
        slices.append(jax.lax.squeeze(part, collapsed))
    batch, offsets = indices.shape[:-1], slices[0].shape
    gathered = jax.lax.reshape(jnp.stack(slices), (*batch, *offsets))
    # The axes of a slice go where the gather says, those of the places to what is left, in order.
    of_slices = dict(zip(map(int, dimension_numbers.offset_dims), range(len(batch), gathered.ndim), strict=True))
    of_places = iter(range(len(batch)))
    order = [of_slices[axis] if axis in of_slices else next(of_places) for axis in range(gathered.ndim)]
    return jax.lax.transpose(gathered, order)


_CALLS = {"jit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}
_REWRITTEN: dict[str, Callable[..., Any]] = {
    "dot_general": _dot_general,
    "gather": _fixed_gather,
    "polynomial": _polynomial,
    "scan": _scan,
}
