"""A function of a batch that few rows need: computed for them alone, a few at a time."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

# Rows computed at a time: more than need it at most steps, and few beside all.
_CHUNK = 16


def for_some_rows(needs: jax.Array, function: Callable[[Any], Any], rows: Any, otherwise: Any) -> Any:
    """`otherwise` with `function(rows)` in the rows that need it.

    Args:
        needs: (n,) bool.
        function: of a batch of any size; a row of its result depends on that row alone.
        rows: pytree of (n, ...).
        otherwise: pytree of (n, ...), as `function` returns it.
    """
    size = min(len(needs), max(_CHUNK, len(needs) // 64))

    def some(carry: tuple[jax.Array, Any]) -> tuple[jax.Array, Any]:
        missing, found = carry
        (ids,) = jnp.nonzero(
            missing, size=size, fill_value=len(missing)
        )  # beyond the end: read clipped, written nowhere
        computed = function(jax.tree.map(lambda values: values[ids], rows))
        found = jax.tree.map(lambda old, new: old.at[ids].set(new, mode="drop"), found, computed)
        return missing.at[ids].set(False, mode="drop"), found

    return jax.lax.while_loop(lambda carry: jnp.any(carry[0]), some, (needs, otherwise))[1]
