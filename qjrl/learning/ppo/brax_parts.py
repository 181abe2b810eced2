"""The pieces taken from brax, imported in one place.

brax 0.14.2 imports mujoco.mjx, which prints two lines to the standard output where warp is not installed.
"""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from brax.training.acme import running_statistics
    from brax.training.agents.ppo.losses import compute_gae
    from brax.training.agents.ppo.networks import PPONetworks, make_ppo_networks

__all__ = ["PPONetworks", "compute_gae", "make_ppo_networks", "running_statistics"]
