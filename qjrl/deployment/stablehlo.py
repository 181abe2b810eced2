"""StableHLO files by `jax.export`: any function of a sample, over a symbolic batch, for several platforms at once."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
from jax import export

from qjrl.deployment.functions import DeployedFunction, Precision


def serialise(deployed: DeployedFunction, precision: Precision, platforms: tuple[str, ...]) -> bytes:
    """The file of a function: (batch, *sample), ... -> dict of (batch, *output); `jax.export.deserialize` reads it."""
    (batch,) = export.symbolic_shape("batch")
    arguments = [jax.ShapeDtypeStruct((batch, *port.shape), port.dtype or precision) for port in deployed.inputs]
    with jax.default_matmul_precision("highest"), _without_places():
        exported = export.export(jax.jit(jax.vmap(deployed.function)), platforms=platforms)(*arguments)
        return bytes(exported.serialize())


def load(content: bytes) -> Callable[..., dict[str, jax.Array]]:
    """The function in a file, as a user of the file gets it."""
    call: Any = jax.jit(export.deserialize(bytearray(content)).call)  # typed as if every function returned one array
    return call


@contextmanager
def _without_places() -> Iterator[None]:
    """Source files are named in the module without the folders of this machine."""
    key = "jax_hlo_source_file_canonicalization_regex"
    before = jax.config.values[key]
    jax.config.update(key, ".*/")
    try:
        yield
    finally:
        jax.config.update(key, before)
