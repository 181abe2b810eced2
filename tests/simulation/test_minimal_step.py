"""One time step: what does not need a simulation."""

import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.simulation.minimal_step import BLOCK, MOST_LANES, in_blocks


@pytest.mark.parametrize("lanes", [1, MOST_LANES, MOST_LANES + 1, 4 * BLOCK - 1, 4 * BLOCK])
def test_blocks_of_lanes_change_nothing(lanes):
    random = np.random.default_rng(lanes)
    one, other = jnp.asarray(random.normal(size=(2, 3, lanes))), jnp.asarray(random.normal(size=lanes))
    most = []

    def function(arguments, scale):
        most.append(scale.shape[-1])
        return {"scaled": arguments["one"] * scale, "sum": jnp.sum(arguments["one"], axis=0)}

    found = in_blocks(function, ({"one": one}, other), lanes)
    np.testing.assert_array_equal(found["scaled"], one * other)
    np.testing.assert_allclose(found["sum"], jnp.sum(one, axis=0), rtol=1e-12)
    assert max(most) <= MOST_LANES if lanes <= MOST_LANES else max(most) <= BLOCK
