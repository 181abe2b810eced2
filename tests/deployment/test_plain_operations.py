"""What jax2onnx mistakes or lacks, rewritten first: the files answer as JAX does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.deployment import onnx_controller, onnx_model
from qjrl.deployment.functions import DeployedFunction, Port

pytestmark = pytest.mark.skipif(bool(onnx_model.missing_packages()), reason="needs the extra onnx, which dev includes")

MATRIX = np.random.default_rng(0).normal(size=(4, 3)).astype(np.float32)


def answers(function, matrix=MATRIX):
    """What the file of a function of one matrix says, and what JAX says."""
    with jax.enable_x64(False):
        expected = np.asarray(jax.jit(function)(matrix))
        ports = Port("matrix", matrix.shape, "-", "any"), Port("answer", expected.shape, "-", "any")
        deployed = DeployedFunction("small", lambda matrix: {"answer": function(matrix)}, ports[:1], ports[1:])
        content = onnx_controller.onnx_bytes(deployed, "float32")
    return onnx_controller.load(content)(matrix)["answer"], expected


@pytest.mark.parametrize(
    "function",
    [
        lambda matrix: matrix.T @ (2.0 * matrix),
        lambda matrix: matrix @ matrix.T,
        lambda matrix: jnp.einsum("ij,kj->ki", matrix, matrix + 1.0),
        lambda matrix: jnp.einsum(
            "bij,bkj->bik", matrix[:, :, None] * matrix[:, None], matrix[:, None, :] * jnp.ones(3)
        ),
        lambda matrix: jnp.tensordot(matrix, matrix, 2)[None],
    ],
    ids=["transposed", "plain", "order of axes", "batch", "two axes"],
)
def test_products(function):
    np.testing.assert_allclose(*answers(function), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "function",
    [
        lambda matrix: matrix[np.array([2, 0, 2])],
        lambda matrix: matrix[:, np.array([[1, 0], [2, 2]])],
        lambda matrix: matrix[np.array([3, 1]), np.array([0, 2])],
        lambda matrix: jax.vmap(lambda row: row[1])(matrix),
        lambda matrix: jax.jacfwd(lambda matrix: matrix[np.array([1, 1])] ** 2)(matrix),
    ],
    ids=["rows", "columns", "places", "one of each row", "slopes"],
)
def test_gathers_at_known_places(function):
    np.testing.assert_allclose(*answers(function), rtol=1e-6)


def test_a_gather_at_an_unknown_place_is_refused():
    with pytest.raises(NotImplementedError, match="not known beforehand"):
        answers(lambda matrix: matrix[(matrix[:2, 0] > 0.0).astype(int)])


def test_loops_over_rows_and_loops_that_repeat():
    weights = jnp.linspace(0.1, 0.4, 4, dtype=jnp.float32)

    def row_by_row(matrix):
        return jax.lax.scan(lambda sum, row: (sum + row[1] * row[0], sum), jnp.zeros(3), (matrix, weights))[1]

    def backwards(matrix):
        return jax.lax.scan(lambda sum, row: (0.5 * sum + row, sum), jnp.zeros(3), matrix, reverse=True)[1]

    def repeated(matrix):
        improve = lambda _, x: x - 0.1 * matrix.T @ (matrix @ x - 1.0)  # noqa: E731
        return jax.lax.fori_loop(0, 20, improve, jnp.ones(3))

    for function in (row_by_row, backwards, jax.jacrev(lambda matrix: row_by_row(matrix)[-1]), repeated):
        np.testing.assert_allclose(*answers(function), rtol=1e-5, atol=1e-6)
