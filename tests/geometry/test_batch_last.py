import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qjrl.geometry import batch_last

RANDOM = np.random.default_rng(0)
COUNT = 7


def with_batch_last(rows):
    return jnp.asarray(np.moveaxis(rows, 0, -1))


def test_products_are_those_of_each_matrix():
    matrices, vectors = RANDOM.normal(size=(2, COUNT, 3, 3)), RANDOM.normal(size=(2, COUNT, 3))
    (a, b), (u, v) = map(with_batch_last, matrices), map(with_batch_last, vectors)
    expected = {
        "product": np.einsum("nij,njk->nik", *matrices),
        "times": np.einsum("nij,nj->ni", matrices[0], vectors[0]),
        "cross": np.cross(*vectors),
        "dot": np.sum(vectors[0] * vectors[1], axis=1),
    }
    found = {
        "product": batch_last.product(a, b),
        "times": batch_last.times(a, u),
        "cross": batch_last.cross(u, v),
        "dot": batch_last.dot(u, v),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(np.moveaxis(np.asarray(found[name]), -1, 0), value, atol=1e-14, err_msg=name)
    np.testing.assert_array_equal(batch_last.product(a, batch_last.identity_like(a)), a)


def test_rows_make_a_matrix():
    entries = RANDOM.normal(size=(2, 3, COUNT))
    np.testing.assert_array_equal(batch_last.from_rows(*entries), entries)


@pytest.mark.parametrize("degrees", [0.0, 1e-5, 1.0, 90.0, 179.0])
def test_rotation_vector_is_that_of_scipy(degrees):
    first = Rotation.random(COUNT, rng=np.random.default_rng(1))
    axes = RANDOM.normal(size=(COUNT, 3))
    vectors = np.radians(degrees) * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    second = Rotation.from_rotvec(vectors) * first
    found = batch_last.rotation_vector(*(with_batch_last(one.as_matrix()) for one in (first, second)))
    np.testing.assert_allclose(found.T, vectors, atol=1e-9)
