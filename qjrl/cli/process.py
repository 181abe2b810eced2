"""The process: what must be set before jax and mujoco are imported, in this one or in a launcher's worker."""

import ctypes
import logging
import os
import platform
import sys
from pathlib import Path

from qjrl import progress
from qjrl.artifacts import hash_of
from qjrl.cores import usable_cores


def prepare() -> None:
    """Environment variables and the log; the user's own settings stay."""
    os.environ["JAX_ENABLE_X64"] = "1"
    os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", "highest")
    # SciPy's LAPACK on two threads takes 30 to 500 times as long beside other work, and little less than one on a free machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if "xla_force_host_platform_device_count" not in os.environ.get(
        "XLA_FLAGS", ""
    ):  # training cuts its arms over them
        flags = f"--xla_force_host_platform_device_count={usable_cores()}"
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(compilation_cache()))
    if sys.platform == "linux" and "MUJOCO_GL" not in os.environ:
        os.environ["MUJOCO_GL"] = _headless_renderer()
    logger = logging.getLogger("qjrl")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [_ConsoleHandler()]


def compilation_cache() -> Path:
    """Folder of compiled programs, one for each instruction set: a home may be shared with a lesser CPU."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "qjrl" / f"jax-{_instruction_set()}"


def _instruction_set() -> str:
    """A short name of what this CPU can execute."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    flags = [line for line in lines if line.startswith(("flags", "Features"))]
    return hash_of(flags[:1] or platform.machine())[:8]


def _headless_renderer() -> str:
    """EGL where its library loads, else OSMesa, else no pictures by MuJoCo."""
    for renderer, library in (("egl", "libEGL.so.1"), ("osmesa", "libOSMesa.so.8"), ("osmesa", "libOSMesa.so")):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return renderer
    return "disable"


class _ConsoleHandler(logging.Handler):
    """Log lines through the console that draws the bars."""

    def emit(self, record: logging.LogRecord) -> None:
        progress.console.print(self.format(record), markup=False)
