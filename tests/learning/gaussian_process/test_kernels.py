import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.learning.gaussian_process.kernels import KERNELS, squared_distances

SQUARED = np.array([0.0, 1e-12, 1e-4, 0.3, 2.0, 30.0])
SHAPE = 0.7


@pytest.mark.parametrize("name", KERNELS)
def test_the_slopes_are_those_of_the_value(name):
    kernel = KERNELS[name]
    value, slope = kernel.with_slope(SQUARED, SHAPE)
    np.testing.assert_array_equal(value, kernel.value(SQUARED, SHAPE))
    by_squared = jax.vmap(jax.grad(kernel.value), (0, None))
    np.testing.assert_allclose(slope[1:], by_squared(jnp.asarray(SQUARED[1:]), SHAPE), rtol=1e-6)
    if kernel.shape_slope is not None:
        by_shape = jax.vmap(jax.grad(kernel.value, argnums=1), (0, None))
        np.testing.assert_allclose(
            kernel.shape_slope(SQUARED, SHAPE), by_shape(jnp.asarray(SQUARED), SHAPE), atol=1e-12
        )


@pytest.mark.parametrize("name", KERNELS)
def test_it_is_one_at_no_distance_falls_with_it_and_is_smooth_there(name):
    value = KERNELS[name].value
    np.testing.assert_allclose(value(SQUARED, SHAPE)[0], 1.0, atol=1e-14)
    assert np.all(np.diff(value(SQUARED, SHAPE)) < 0)
    here = jnp.array([0.3, -0.2])
    slope = jax.grad(lambda at: value(squared_distances(at, here[None]), SHAPE)[0])(here)
    np.testing.assert_allclose(slope, 0.0, atol=1e-12)


def test_squared_distances_are_those_between_the_rows():
    one, other = np.random.default_rng(0).normal(size=(2, 7, 3))
    direct = np.sum((one[:, None] - other[None]) ** 2, axis=2)
    np.testing.assert_allclose(squared_distances(one, other), direct, atol=1e-13)
    np.testing.assert_allclose(squared_distances(jnp.asarray(one[0]), other), direct[0], atol=1e-13)
    assert np.asarray(squared_distances(one, one)).min() >= 0.0
