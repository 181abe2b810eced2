"""One time step: what does not need a simulation."""

import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.robot.quaternion_arm.minimal_step import BLOCK, MOST_AT_ONCE, in_blocks


@pytest.mark.parametrize("batch", [1, MOST_AT_ONCE, MOST_AT_ONCE + 1, 4 * BLOCK - 1, 4 * BLOCK])
def test_blocks_change_nothing(batch):
    random = np.random.default_rng(batch)
    one, other = jnp.asarray(random.normal(size=(2, 3, batch))), jnp.asarray(random.normal(size=batch))
    most = []

    def function(arguments, scale):
        most.append(scale.shape[-1])
        return {"scaled": arguments["one"] * scale, "sum": jnp.sum(arguments["one"], axis=0)}

    found = in_blocks(function, ({"one": one}, other), batch)
    np.testing.assert_array_equal(found["scaled"], one * other)
    np.testing.assert_allclose(found["sum"], jnp.sum(one, axis=0), rtol=1e-12)
    assert max(most) <= MOST_AT_ONCE if batch <= MOST_AT_ONCE else max(most) <= BLOCK
