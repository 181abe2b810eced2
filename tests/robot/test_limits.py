"""Limits of coordinates: discs of pairs and boxes; what they bring back, and which motions they leave."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.robot.limits import Box, Discs

DISCS, BOX = Discs(jnp.asarray(1.2)), Box(jnp.array([-1.0, 0.0, -2.0, -0.5]), jnp.array([1.0, 0.5, 3.0, 0.5]))


def nearest_inside(limits, coordinates):
    """By many steps of a search along the free motions alone: an answer that does not know the shape of the limits."""
    found = limits.within(jnp.zeros_like(coordinates))
    for _ in range(400):
        slope = coordinates - found
        free = limits.free_motions(found, slope, jnp.eye(len(slope))[..., None] * jnp.ones(slope.shape[1]))
        found = limits.within(found + 0.2 * jnp.einsum("ij...,i...->j...", free, slope))
    return found


@pytest.mark.parametrize("limits", [DISCS, BOX], ids=["discs", "box"])
def test_what_is_brought_back_is_the_nearest_within_the_limits(limits):
    coordinates = jnp.asarray(np.random.default_rng(0).normal(size=(4, 50)) * 2.0)
    within = jax.jit(lambda values: limits.within(values))(coordinates)
    np.testing.assert_allclose(within, nearest_inside(limits, coordinates), atol=1e-5)
    np.testing.assert_allclose(limits.within(within), within, atol=1e-15)  # once is enough
    assert np.any(np.abs(within - coordinates) > 0.1)


@pytest.mark.parametrize("limits", [DISCS, BOX], ids=["discs", "box"])
def test_what_is_inside_stays_to_the_bit_and_keeps_all_its_motions(limits):
    inside = jnp.array([[0.3, -0.4], [0.25, 0.1], [0.0, 0.7], [0.4, -0.3]])
    jacobian, slope = jnp.asarray(np.random.default_rng(1).normal(size=(6, 4, 2))), jnp.ones((4, 2))
    np.testing.assert_allclose(limits.within(inside), inside, rtol=1e-15)
    np.testing.assert_array_equal(limits.free_motions(inside, slope, jacobian), jacobian)


def test_a_pair_at_the_edge_moves_along_it_and_inward_but_not_outward():
    at_edge, jacobian = jnp.array([1.2, 0.0, 0.0, 0.0]), jnp.eye(4)
    outward, inward = jnp.array([1.0, 0.5, 0.0, 0.0]), jnp.array([-1.0, 0.5, 0.0, 0.0])
    np.testing.assert_allclose(
        DISCS.free_motions(at_edge, outward, jacobian), np.diag([0.0, 1.0, 1.0, 1.0]), atol=1e-15
    )
    np.testing.assert_array_equal(DISCS.free_motions(at_edge, inward, jacobian), jacobian)


def test_a_coordinate_at_its_bound_is_held_if_it_would_leave():
    at_bounds, slope = jnp.array([1.0, 0.0, 3.0, 0.5]), jnp.array([1.0, -1.0, -1.0, 0.0])
    np.testing.assert_array_equal(BOX.free_motions(at_bounds, slope, jnp.eye(4)), np.diag([0.0, 0.0, 1.0, 1.0]))
