"""Vectors of separate components against numpy, with and without Python numbers among them."""

import numpy as np
import pytest

from qjrl.geometry.vectors import IDENTITY, ZERO, Matrix, Symmetric, Vector, both_ways, square


def drawn(random) -> Vector:
    """Every component an array, a zero, a one or another number."""
    one = lambda: [random.normal(size=3), 0.0, 1.0, float(random.normal())][random.integers(4)]  # noqa: E731
    return Vector(one(), one(), one())


def full(vector: Vector) -> np.ndarray:
    return np.stack([np.broadcast_to(value, 3) for value in vars(vector).values()])


def of(matrix: Matrix) -> np.ndarray:
    return np.stack([full(column) for column in (matrix.x, matrix.y, matrix.z)], axis=1)


@pytest.mark.parametrize("seed", range(20))
def test_operations_are_those_of_numpy_whatever_the_components_are(seed):
    random = np.random.default_rng(seed)
    a, b, c = (drawn(random) for _ in range(3))
    np.testing.assert_allclose(full(a + b), full(a) + full(b))
    np.testing.assert_allclose(full(a - b), full(a) - full(b))
    np.testing.assert_allclose(np.broadcast_to(a.dot(b), 3), np.sum(full(a) * full(b), axis=0), atol=1e-12)
    np.testing.assert_allclose(full(a.cross(b)), np.cross(full(a), full(b), axis=0), atol=1e-12)
    matrix, other = Matrix(a, b, c), Matrix(b, a, c)
    np.testing.assert_allclose(full(matrix.times(a)), np.einsum("ijl,jl->il", of(matrix), full(a)), atol=1e-12)
    np.testing.assert_allclose(
        full(matrix.transposed_times(a)), np.einsum("jil,jl->il", of(matrix), full(a)), atol=1e-12
    )
    product = np.einsum("ijl,jkl->ikl", of(matrix), of(other))
    np.testing.assert_allclose(of(matrix.product(other)), product, atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_symmetric_matrices_turn_and_multiply(seed):
    random = np.random.default_rng(seed)
    a, b, c = (drawn(random) for _ in range(3))
    found: Symmetric = square(a, a.scaled(2.0)) + both_ways(a, b)
    expected = 2.0 * np.einsum("il,jl->ijl", full(a), full(a))
    expected += np.einsum("il,jl->ijl", full(a), full(b)) + np.einsum("il,jl->ijl", full(b), full(a))
    np.testing.assert_allclose(of(found.columns()), expected, atol=1e-12)
    np.testing.assert_allclose(full(found.times(c)), np.einsum("ijl,jl->il", expected, full(c)), atol=1e-12)
    np.testing.assert_allclose(np.broadcast_to(found.trace(), 3), np.einsum("iil->l", expected), atol=1e-12)
    rotation = Matrix(a, b, c)
    turned = np.einsum("ijl,jkl,mkl->iml", of(rotation), expected, of(rotation))
    np.testing.assert_allclose(of(found.turned(rotation).columns()), turned, atol=1e-10)


def test_zeros_and_ones_cost_no_operation():
    vector = Vector("x", "y", "z")  # no arithmetic is possible with these
    assert IDENTITY.times(vector) == vector
    assert vector + ZERO == vector
    assert ZERO.cross(vector) == ZERO
