"""Where a robot rests when its motors hold, and what would move it from there."""

from typing import Any

from flax import struct


@struct.dataclass
class Equilibrium:
    """Configuration at rest, and its slopes; each has the configuration's axes first."""

    configuration: Any
    by_gain: Any
    """(...) for each unit of the logarithm of the strands' stiffness."""
    by_tilt: Any
    """(..., 2) for each radian by which the base leans about x and about y."""
    by_pull: Any
    """(..., strands) for each newton with which a strand pulls besides, as friction does."""
