"""One PPO update in a process of its own: `python sharded_update.py OUT [ADDRESS PROCESS]`.

Without an address on all devices of this process; with one as process 0 or 1 of two, each with half of the envs.
"""

import dataclasses
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from test_ppo_update import ACTIONS, CONFIG, ENVS, SIZES, STEPS, last_observation, rollout

from qjrl.artifacts import write_arrays
from qjrl.learning.ppo import mesh as meshes
from qjrl.learning.ppo.networks import initial_parameters, make_networks
from qjrl.learning.ppo.normaliser import initial_normaliser, update_normaliser
from qjrl.learning.ppo.update import make_learner, make_update


def whole_rollout():
    """With an invalid, a terminated and a truncated row."""
    found = rollout()
    found.valid[2, 1], found.terminated[1, 2], found.truncated[3, 0] = False, True, True
    return dataclasses.replace(
        found, final_value=np.linspace(0.0, 1.0, STEPS * ENVS, dtype=np.float32).reshape(STEPS, ENVS)
    )


def updated(mesh=None) -> dict[str, np.ndarray]:
    """Leaves of learner, metrics and normaliser after one update, on a mesh or without one."""
    networks = make_networks(CONFIG, SIZES, ACTIONS)
    learner = make_learner(CONFIG, initial_parameters(networks, 0.3, jax.random.key(0)))
    same = learner, initial_normaliser(SIZES), jax.random.key(1), jnp.bool_(True)
    steps, rows = whole_rollout(), last_observation()
    if mesh is not None:
        same = meshes.everywhere(mesh, same)
        steps, rows = cut(mesh, steps, PartitionSpec(None, "envs")), cut(mesh, rows, PartitionSpec("envs"))
    learner, normaliser, key, moves_actor = same
    normaliser = jax.jit(update_normaliser)(normaliser, steps.observation, steps.valid)
    update = jax.jit(make_update(networks, CONFIG, mesh))
    found = update(learner, normaliser, steps, rows, key, moves_actor), normaliser
    return {str(index): meshes.on_host(leaf) for index, leaf in enumerate(jax.tree.leaves(found))}


def cut(mesh, tree, spec):
    """Every process holds the whole arrays, and places its part of them."""
    sharding = NamedSharding(mesh, spec)

    def place(leaf):
        return jax.make_array_from_callback(leaf.shape, sharding, lambda index: leaf[index])

    return jax.tree.map(place, tree)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        jax.distributed.initialize(sys.argv[2], num_processes=2, process_id=int(sys.argv[3]))
    assert jax.device_count() == 2
    write_arrays(Path(sys.argv[1]), updated(meshes.device_mesh()))
