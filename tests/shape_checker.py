"""The type checker of the tests, with two freedoms: an int may stand for a float, a numpy array for one of JAX."""

import jax
import numpy as np
from beartype import BeartypeConf, BeartypeHintOverrides, beartype

_FREEDOMS = BeartypeHintOverrides({jax.Array: jax.Array | np.ndarray})  # pyright: ignore[reportCallIssue]

check = beartype(conf=BeartypeConf(is_pep484_tower=True, hint_overrides=_FREEDOMS))
