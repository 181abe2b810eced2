"""An update on all devices of all processes: rollouts lie cut by environment, the learner lies everywhere."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from qjrl.learning.ppo.normaliser import Normaliser
from qjrl.learning.ppo.rollout import Rollout
from qjrl.learning.ppo.update import Learner

_ENVS = "envs"


def device_mesh() -> Mesh:
    """All devices of all processes in a row."""
    return Mesh(np.array(jax.devices()), (_ENVS,))


def update_on(mesh: Mesh, update: Callable[..., Any]) -> Callable[..., Any]:
    """`update.make_update`'s function on a mesh, from and to arrays of this process.

    The arithmetic is that of one device with the environments of all processes; XLA adds the sums over devices. What goes
    in as learner, normaliser and key must be the same in every process, and comes out the same.
    """

    def run(
        learner: Learner,
        normaliser: Normaliser,
        rollout: Rollout,
        final_values: jax.Array,
        key: jax.Array,
        moves_actor: jax.Array,
    ) -> tuple[Learner, dict[str, jax.Array]]:
        everywhere = [_everywhere(mesh, tree) for tree in (learner, normaliser, key, moves_actor)]
        cut = spread(mesh, rollout), _cut(mesh, final_values, 1)
        return local(update(everywhere[0], everywhere[1], *cut, *everywhere[2:]))

    return run


def normaliser_on(mesh: Mesh, update_normaliser: Callable[..., Any]) -> Callable[..., Any]:
    """`normaliser.update_normaliser` with the observations of all processes, from and to arrays of this process."""

    def run(normaliser: Normaliser, observation: Any, valid: jax.Array) -> Normaliser:
        rows = jax.tree.map(lambda value: _cut(mesh, value, 1), observation)
        return local(update_normaliser(_everywhere(mesh, normaliser), rows, _cut(mesh, valid, 1)))

    return run


def spread(mesh: Mesh, rollout: Rollout) -> Rollout:
    """This process's rollout as its part of the whole one, cut by environment."""
    cut = jax.tree.map(lambda value: _cut(mesh, value, 1), rollout)
    return cut.replace(last_observation=_cut(mesh, rollout.last_observation, 0))


def local(tree: Any) -> Any:
    """Arrays that lie everywhere, as those of this process's first device."""
    return jax.tree.map(lambda value: value.addressable_data(0), tree)


def _cut(mesh: Mesh, value: Any, axis: int) -> jax.Array:
    sharding = NamedSharding(mesh, P(*[None] * axis, _ENVS))
    return jax.make_array_from_process_local_data(sharding, np.asarray(value))


def _everywhere(mesh: Mesh, tree: Any) -> Any:
    """Copies on every device; keys by way of their numbers, which know no device."""
    sharding = NamedSharding(mesh, P())

    def put(value: Any) -> jax.Array:
        if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
            return jax.random.wrap_key_data(put(jax.random.key_data(value)))
        return jax.make_array_from_process_local_data(sharding, np.asarray(value))

    return jax.tree.map(put, tree)
