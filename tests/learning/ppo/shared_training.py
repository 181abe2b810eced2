"""A whole training, DAgger and PPO, in a process of its own: `python shared_training.py OUT SHARE [ADDRESS PROCESS]`.

SHARE: probability that an env is broken; a training that stops for it ends with exit code 3. Without an address on all
devices of this process alone; with one as process 0 or 1 of two.
"""

import sys
from pathlib import Path

import jax
import numpy as np
from drifting_environment import NUM_ENVS, DriftingEnvironment
from test_ppo_dagger import CONFIG

from qjrl.artifacts import write_arrays
from qjrl.learning import processes
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.train import train

if __name__ == "__main__":
    out, share = Path(sys.argv[1]), np.float32(sys.argv[2])
    if len(sys.argv) > 3:
        processes.join(sys.argv[3], 2, int(sys.argv[4]))
    directory = out / ("training" if processes.is_first() else "other")
    try:
        policy = train(DriftingEnvironment(share), CONFIG, NUM_ENVS, 0, directory)
    except TrainingDiverged:
        sys.exit(3)
    leaves = {str(index): leaf for index, leaf in enumerate(jax.tree.leaves(policy))}
    write_arrays(out / f"policy-{jax.process_index()}.npz", leaves)
