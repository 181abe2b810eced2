"""One PPO update in a process of its own: `python sharded_update.py OUT [ADDRESS PROCESS]`.

Without an address on all devices of this process; with one as process 0 or 1 of two, each with half of the environments.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from test_ppo_update import ACTIONS, CONFIG, ENVS, SIZES, STEPS, rollout

from qjrl.artifacts import write_arrays
from qjrl.learning.ppo import sharding
from qjrl.learning.ppo.networks import initial_parameters, make_networks
from qjrl.learning.ppo.normaliser import initial_normaliser, update_normaliser
from qjrl.learning.ppo.update import make_learner, make_update


def whole_rollout():
    """With an invalid, a terminated and a truncated row."""
    found = rollout()
    found.valid[2, 1], found.terminated[1, 2], found.truncated[3, 0] = False, True, True
    return found


def updated(is_sharded: bool, environments: slice = slice(None)) -> dict[str, np.ndarray]:
    """Leaves of learner, metrics and normaliser after one update."""
    own = jax.tree.map(lambda value: value[:, environments], whole_rollout())
    own = own.replace(last_observation=whole_rollout().last_observation[environments])
    networks = make_networks(CONFIG, SIZES, ACTIONS)
    update, take_in = make_update(networks, CONFIG), jax.jit(update_normaliser)
    if is_sharded:
        mesh = sharding.device_mesh()
        update, take_in = sharding.update_on(mesh, update), sharding.normaliser_on(mesh, take_in)
    learner = make_learner(CONFIG, initial_parameters(networks, 0.3, jax.random.key(0)))
    normaliser = take_in(initial_normaliser(SIZES), own.observation, own.valid)
    final_values = np.linspace(0.0, 1.0, STEPS * ENVS, dtype=np.float32).reshape(STEPS, ENVS)[:, environments]
    found = update(learner, normaliser, own, final_values, jax.random.key(1), jnp.bool_(True))
    return {str(index): np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves((found, normaliser)))}


if __name__ == "__main__":
    environments = slice(None)
    if len(sys.argv) > 2:
        process = int(sys.argv[3])
        jax.distributed.initialize(sys.argv[2], num_processes=2, process_id=process)
        environments = slice(process * ENVS // 2, (process + 1) * ENVS // 2)
    assert jax.device_count() == 2
    write_arrays(Path(sys.argv[1]), updated(True, environments))
