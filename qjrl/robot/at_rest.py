"""Robots at rest, as a kind with statics of its own answers them."""

from typing import Any

from flax import struct


@struct.dataclass
class AtRest:
    """One row a command; on the host."""

    pose: Any
    """(n, 9) of the tip, without the noise of measuring it [m, -]."""
    configuration: Any
    """(n, ...) nearest configuration of the kind."""
    strand_tension: Any
    """(n, num_strands) [N]."""
    positions: Any
    """(n, num_positions) of whatever the statics solves for."""
    has_rested: Any
    """(n,) whether an equilibrium was found."""
