"""Settings of every test: double precision as in the `qjrl` command, no key used twice, shapes of every call checked.

Compiled programs are kept where the command keeps them, for the processes that tests start as well.
"""

import os
from pathlib import Path

from qjrl.cli.process import compilation_cache

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(compilation_cache()))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the command, before SciPy is imported

import jax
import jaxtyping
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_debug_key_reuse", True)
jaxtyping.Array = jax.Array | np.ndarray  # a numpy array may stand for one of JAX; its shape is checked all the same
jaxtyping.install_import_hook(["qjrl.geometry", "qjrl.robot", "qjrl.simulation", "qjrl.solvers"], "shape_checker.check")

# How long an example takes says nothing on a busy machine.
settings.register_profile("qjrl", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("qjrl")


# Whole files that take longest, first: beside the last of the others none is left that runs alone.
LONGEST = (
    "stages/test_stages.py",
    "control/test_policy_training.py",
    "control/test_gymnasium_adapter.py",
    "control/test_environment.py",
    "deployment/test_export.py",
    "control/test_planar_arm.py",
    "control/test_arm_estimate.py",
    "solvers/test_models_as_arguments.py",
    "control/test_evaluation.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, the others in their order; `make test` has xdist keep it."""
    places = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(places)))


@pytest.fixture(autouse=True, scope="module")
def compiled_programs_are_let_go():
    """Let compiled programs go before a process has as many memory mappings as Linux allows (65,530 by default).

    XLA aborts the process beyond that. A thousand tests in one process reach it.
    """
    yield
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > 20_000:
        jax.clear_caches()
