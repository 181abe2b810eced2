"""Where there must be arms at rest: one line instead of medians of nothing."""

import numpy as np

from qjrl.config import ConfigError


def require_rest(has_rested: np.ndarray, what: str) -> None:
    """Refuse to go on with answers of which none came to rest.

    Args:
        has_rested: (n,) whether each did.
        what: whose they are, the stage first: "ik: learned answers to uniform targets".
    Raises:
        ConfigError: none did; one line that says what can be done.
    """
    if not np.any(has_rested):
        raise ConfigError(
            f"{what}: none of {len(has_rested)} came to rest; look at the arm with stages=[describe], then change it (payload, "
            "joint damping, stiffness) or group simulation (damping_scale, max_time)"
        )


def require_valid(is_valid: np.ndarray, what: str) -> None:
    """Refuse to sum up episodes of which none is sound.

    Args:
        is_valid: (n,) whether an episode neither diverged nor lost its arm.
        what: whose they are, the stage first.
    Raises:
        ConfigError: none is; one line that says what can be done.
    """
    if not np.any(is_valid):
        raise ConfigError(
            f"{what}: none of {len(is_valid)} episodes is sound: each simulation diverged, lost its arm or came too late; look "
            "at the arm with stages=[describe], then change it or policy.environment"
        )
