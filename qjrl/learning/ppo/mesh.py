"""All devices of all processes in a row, over which the envs of a training are dealt out; the learner lies on each.

One path for GPUs, for the cores of a CPU (as host devices), and for several processes.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from qjrl.learning import processes

ENVS = "envs"


def device_mesh() -> Mesh:
    """All devices of all processes."""
    return Mesh(np.array(jax.devices()), (ENVS,))


def everywhere(mesh: Mesh, tree: Any) -> Any:
    """Arrays that are the same in every process, on every device."""
    return jax.tree.map(lambda leaf: _placed(NamedSharding(mesh, P()), leaf), tree)


def dealt_out(mesh: Mesh, tree: Any) -> Any:
    """Arrays with a row an env, the rows of all processes on the host of each, as arrays cut over the devices."""
    sharding = NamedSharding(mesh, P(ENVS))
    return jax.tree.map(lambda leaf: _placed(sharding, leaf, processes.own), tree)


def on_host(tree: Any) -> Any:
    """Numpy arrays of what `everywhere` or `dealt_out` placed: all rows, in every process. Keys as their numbers."""
    return jax.tree.map(_fetched, tree)


def _placed(sharding: NamedSharding, leaf: Any, own: Any = lambda rows: rows) -> jax.Array:
    """Keys by way of their numbers, which know no device."""
    if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_placed(sharding, jax.random.key_data(leaf), own))
    return jax.make_array_from_process_local_data(sharding, own(np.asarray(leaf)))


def _fetched(leaf: Any) -> np.ndarray:
    leaf = jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf
    if leaf.is_fully_replicated or leaf.is_fully_addressable:
        return np.array(leaf.addressable_data(0) if leaf.is_fully_replicated else leaf)
    from jax.experimental import multihost_utils

    return np.asarray(multihost_utils.process_allgather(leaf, tiled=True))
