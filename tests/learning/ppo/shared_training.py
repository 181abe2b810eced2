"""A whole training, imitation and PPO, in a process of its own: `python shared_training.py OUT [ADDRESS PROCESS]`.

Without an address with all copies of the environment; with one as process 0 or 1 of two, each with half of them.
"""

import sys
from pathlib import Path

import jax
from drifting_environment import NUM_ENVS, DriftingEnvironment
from test_ppo_imitation import CONFIG

from qjrl.artifacts import write_arrays
from qjrl.learning import processes
from qjrl.learning.ppo.train import train

if __name__ == "__main__":
    out = Path(sys.argv[1])
    if len(sys.argv) > 2:
        processes.join(sys.argv[2], 2, int(sys.argv[3]))
    own = processes.own_rows(NUM_ENVS)
    directory = out / ("training" if processes.is_first() else "nothing_is_written_here")
    policy = train(DriftingEnvironment(own), CONFIG, 0, directory)
    leaves = {str(index): leaf for index, leaf in enumerate(jax.tree.leaves(policy))}
    write_arrays(out / f"policy-{jax.process_index()}.npz", leaves)
