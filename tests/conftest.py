"""Settings of every test: double precision as in the `qjrl` command, no key used twice, shapes of every call checked."""

import jax
import jaxtyping
import numpy as np
from hypothesis import HealthCheck, settings

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_debug_key_reuse", True)
jaxtyping.Array = jax.Array | np.ndarray  # a numpy array may stand for one of JAX; its shape is checked all the same
jaxtyping.install_import_hook(["qjrl.geometry", "qjrl.robot", "qjrl.simulation", "qjrl.solvers"], "shape_checker.check")

# How long an example takes says nothing on a busy machine.
settings.register_profile("qjrl", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("qjrl")
