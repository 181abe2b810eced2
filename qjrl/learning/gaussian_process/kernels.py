"""Kernels as functions of the squared distance between scaled inputs, for NumPy on the host and for JAX alike.

At squared distance 0 each is 1; the signal's variance multiplies it elsewhere. Source: Rasmussen and Williams, Gaussian Processes
for Machine Learning, chapter 4.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

KernelName = Literal["squared_exponential", "matern_52", "rational_quadratic"]


@dataclasses.dataclass(frozen=True)
class Kernel:
    """One kernel."""

    value: Callable[[Any, Any], Any]
    """(squared distances, shape) -> their correlations, of the same form."""
    with_slope: Callable[[Any, Any], tuple[Any, Any]]
    """(squared distances, shape) -> correlations, and their derivatives by the squared distance."""
    shape_slope: Callable[[Any, Any], Any] | None = None
    """(squared distances, shape) -> derivative by the shape; None: it has no shape parameter."""


def squared_distances(one: Any, other: Any) -> Any:
    """|x - y|^2 of rows (..., d) and (n, d), already divided by their length scales: (..., n), never below 0."""
    numbers = one.__array_namespace__()
    products = (-2.0 * one) @ other.T
    return numbers.maximum(products + numbers.sum(one**2, axis=-1)[..., None] + numbers.sum(other**2, axis=-1), 0.0)


def _squared_exponential(squared: Any, shape: Any) -> Any:
    """exp(-r^2 / 2)."""
    del shape
    return squared.__array_namespace__().exp(-0.5 * squared)


def _squared_exponential_with_slope(squared: Any, shape: Any) -> tuple[Any, Any]:
    value = _squared_exponential(squared, shape)
    return value, -0.5 * value


def _matern_52(squared: Any, shape: Any) -> Any:
    """(1 + s + s^2 / 3) exp(-s), s = sqrt(5) r."""
    del shape
    decay, s = _decay(squared)
    return (1.0 + s + s**2 / 3.0) * decay


def _matern_52_with_slope(squared: Any, shape: Any) -> tuple[Any, Any]:
    del shape
    decay, s = _decay(squared)
    return (1.0 + s + s**2 / 3.0) * decay, (-5.0 / 6.0) * (1.0 + s) * decay


def _decay(squared: Any) -> tuple[Any, Any]:
    """exp(-s) and s. At no distance s is 1e-15 instead of 0, where a square root has no slope."""
    numbers = squared.__array_namespace__()
    s = numbers.sqrt(numbers.maximum(5.0 * squared, 1e-30))
    return numbers.exp(-s), s


def _rational_quadratic(squared: Any, shape: Any) -> Any:
    """(1 + r^2 / (2 a))^-a."""
    return (1.0 + squared / (2.0 * shape)) ** -shape


def _rational_quadratic_with_slope(squared: Any, shape: Any) -> tuple[Any, Any]:
    value = _rational_quadratic(squared, shape)
    return value, -0.5 * value / (1.0 + squared / (2.0 * shape))


def _rational_quadratic_shape_slope(squared: Any, shape: Any) -> Any:
    numbers, ratio = squared.__array_namespace__(), squared / (2.0 * shape)
    return _rational_quadratic(squared, shape) * (ratio / (1.0 + ratio) - numbers.log1p(ratio))


KERNELS: dict[str, Kernel] = {
    "squared_exponential": Kernel(_squared_exponential, _squared_exponential_with_slope),
    "matern_52": Kernel(_matern_52, _matern_52_with_slope),
    "rational_quadratic": Kernel(_rational_quadratic, _rational_quadratic_with_slope, _rational_quadratic_shape_slope),
}
