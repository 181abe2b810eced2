"""Named streams of random numbers: each purpose has a key of its own, whatever the seed of the run.

The number of a purpose is a hash of its name. It is folded into the key of the seed, so that no stream is a child of
another one: `split(key)[i]` equals `fold_in(key, i)` in JAX, and rows of a batch are folded in by their small numbers.
"""

import hashlib
from typing import Literal, get_args

import jax

Purpose = Literal[
    "networks",
    "actions and minibatches",
    "training arms",
    "arms of the checkpoints' evaluation",
    "arms of the comparison",
    "arms of the residual study",
    "encoder floor of the residual study",
    "held-out targets",
    "target bank",
    "targets of the open loop",
    "reachable targets",
    "fresh poses of the pretension",
    "rows of the parity check",
    "members of an ensemble",
    "noise of the measured poses",
    "anchors of a continuum arm",
    "home lengths of a continuum arm",
    "cable gains of a continuum arm",
    "tip frame of a continuum arm",
    "preset bends of a continuum arm",
]
PURPOSES: tuple[Purpose, ...] = get_args(Purpose)
_SMALLEST = 1 << 24
"""Below it lie the numbers of rows, which are folded into the same keys."""


def number_of(purpose: Purpose) -> int:
    """The number of a purpose, from 2^24 to 2^32 - 1.

    Raises:
        ValueError: nobody has registered the purpose.
    """
    if purpose not in PURPOSES:
        raise ValueError(f"purpose: got {purpose!r}, allowed: {', '.join(PURPOSES)}")
    return max(_hash(purpose), _SMALLEST)


def key_for(seed: int, purpose: Purpose) -> jax.Array:
    """The key of a purpose in the run of a seed."""
    return jax.random.fold_in(jax.random.key(seed), number_of(purpose))


def seed_for(seed: int, purpose: Purpose, number: int = 0) -> int:
    """A seed, from 0 to 2^31 - 1, for what asks for one: of a purpose, and of the `number`-th thing that has it."""
    number_of(purpose)
    return _hash(f"{purpose} {number} of {seed}") >> 1


def _hash(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4])
