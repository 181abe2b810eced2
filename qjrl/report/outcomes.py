"""What one controller did on one set of targets, as plain arrays, and the words a reader sees for both."""

import dataclasses

import numpy as np

CONTROLLER_LABELS = {
    "fabrik": "FABRIK",
    "least_squares": "least squares, closed form",
    "nominal": "nominal closed form",
    "learned_ik": "learned IK",
}

TARGET_SET_LABELS = {"uniform": "uniform bends", "near_home": "near home"}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Errors and strand tensions at the end of every target; rows of one target set are the same targets."""

    controller: str
    target_set: str
    position_error: np.ndarray
    """(n,) [m]."""
    orientation_error: np.ndarray
    """(n,) [rad]."""
    strand_tension: np.ndarray
    """(n, strands) [N]."""
    is_slack: np.ndarray
    """(n, strands) whether a strand carries no tension."""
    num_left_out: int = 0
    """Targets without a row: never settled, diverged, or out of the motors' time."""

    def __post_init__(self):
        for name in ("position_error", "orientation_error", "strand_tension"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64))
        object.__setattr__(self, "is_slack", np.asarray(self.is_slack, bool))
        count = len(self.position_error)
        if count == 0 or self.position_error.ndim != 1 or self.orientation_error.shape != (count,):
            raise ValueError(
                f"{self}: got errors of shape {self.position_error.shape} and {self.orientation_error.shape}, "
                "allowed: (n,) both, n at least 1"
            )
        if (
            self.strand_tension.ndim != 2
            or len(self.strand_tension) != count
            or self.is_slack.shape != self.strand_tension.shape
        ):
            raise ValueError(
                f"{self}: got tensions {self.strand_tension.shape} and slack {self.is_slack.shape}, allowed: ({count}, strands) both"
            )
        arrays = (self.position_error, self.orientation_error, self.strand_tension)
        if not all(np.isfinite(array).all() for array in arrays):
            raise ValueError(
                f"{self}: got non-finite values, allowed: finite; leave such rows out and count them in num_left_out"
            )

    def __str__(self) -> str:
        return f"outcome of {self.controller} on {self.target_set}"

    @property
    def position_error_mm(self) -> np.ndarray:
        """(n,) [mm]."""
        return 1e3 * self.position_error

    @property
    def orientation_error_deg(self) -> np.ndarray:
        """(n,) [deg]."""
        return np.degrees(self.orientation_error)


def controller_label(name: str) -> str:
    """The words for a controller in tables and legends: those of its parts, "learned_ik+dither" being "learned IK + dither"."""
    return " + ".join(CONTROLLER_LABELS.get(part, part.replace("_", " ")) for part in name.split("+"))


def target_set_label(name: str) -> str:
    """The words for a target set in tables and titles."""
    return TARGET_SET_LABELS.get(name, name.replace("_", " "))
