"""How far poses of a model lie from those of a data set, in millimetres and degrees."""

from typing import Any

import numpy as np

from qjrl.geometry.pose import row_errors


def pose_errors(poses: Any, truth: Any) -> dict[str, float]:
    """Quantiles of position error [mm] and orientation error [deg] over rows (n, 9)."""
    position, orientation = row_errors(poses, truth)
    millimetres, degrees = 1e3 * position, np.degrees(orientation)
    return {
        "median_mm": float(np.median(millimetres)),
        "p90_mm": float(np.percentile(millimetres, 90)),
        "p99_mm": float(np.percentile(millimetres, 99)),
        "median_deg": float(np.median(degrees)),
        "p90_deg": float(np.percentile(degrees, 90)),
        "p99_deg": float(np.percentile(degrees, 99)),
    }
