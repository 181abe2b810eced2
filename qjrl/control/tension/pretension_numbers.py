"""What the search for the least pretension found, in numbers."""

from typing import Any

import numpy as np

from qjrl.control.tension.poses import PoseSet
from qjrl.control.tension.pretension import (
    Choice,
    PretensionConfig,
    Survey,
    lowest_tension,
    needed_pretension,
    off_nominal,
)
from qjrl.control.tension_check import TensionCheck
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot


def point_of(pretension: float, check: TensionCheck, poses: PoseSet) -> dict[str, float]:
    """What one pretension does over all poses [N, m, deg, shares]; of the settled ones, NaN where there are none."""
    rest, joint = check.rest, check.robot.config.joint
    settled = rest.converged
    least, off = lowest_tension(check)[settled], off_nominal(check, poses)[settled]
    bend = np.degrees(2.0 * np.arcsin(np.linalg.norm(rest.bends[settled], axis=-1)))
    return {
        "pretension": pretension,
        "safe_share": float(check.is_safe.mean()),
        "below_share": float(check.is_slack.any(axis=1).mean()),
        "slack_share": float((rest.is_slack.any(axis=1) & settled).mean()),
        "unsettled_share": float(check.is_unsettled.mean()),
        "stopped_share": float((bend > joint.bend_limit_deg + 0.5 * joint.stop_margin_deg).any(axis=1).sum() / len(settled)),
        "least_tension": _of(np.min, least),
        "median_least_tension": _of(np.median, least),
        "largest_tension": _of(np.max, rest.strand_tension[settled]),
        "largest_motor_force": _of(np.max, np.abs(rest.motor_force[settled])),
        "largest_bend_deg": _of(np.max, bend),
        "median_off_nominal": _of(np.median, off),
        "p99_off_nominal": _of(lambda values: np.percentile(values, 99), off),
        "largest_off_nominal": _of(np.max, off),
    }  # fmt: skip


def points_of(found: Survey, choice: Choice) -> list[dict[str, float]]:
    """`point_of` every pretension of the curve and of the answer, rising."""
    checks = found.checks | {choice.at: choice.check}
    return [point_of(pretension, checks[pretension], found.poses) for pretension in sorted(checks)]


def override(choice: Choice) -> str:
    """What to add to the command line, or beside the others in a robot's YAML; empty where there is no answer."""
    return "" if choice.pretension is None else f"robot.strands.pretension={choice.pretension:.10g}"


def least_by_count(config: PretensionConfig, found: Survey) -> dict[str, float | None]:
    """Number of poses -> pretension that the first so many of them need [N], interpolated on the curve; None: more than that."""
    needed = needed_pretension(config, found)
    counts = [len(needed) >> shift for shift in (4, 3, 2, 1, 0) if len(needed) >> shift]
    largest = {str(count): float(needed[:count].max()) for count in counts}
    return {count: value if np.isfinite(value) else None for count, value in largest.items()}


def metrics_of(robot: Robot, config: PretensionConfig, found: Survey, choice: Choice) -> dict[str, Any]:
    """Content of `metrics.json`."""
    own = float(robot.pretension)
    return {
        "least_pretension": choice.pretension,
        "too_little": choice.too_little,
        "override": override(choice),
        "asked": {
            "least_tension": config.least_tension,
            "share": config.share,
            "poses": len(found.poses),
            "path": config.path,
        },
        "own": {"pretension": own, "message": found.checks[own].message},
        "at": {"pretension": choice.at, "message": choice.check.message, "settled_by_search": choice.num_settled},
        "curve": points_of(found, choice),
        "least_by_count": least_by_count(config, found),
        "poses_that_lose_tension": found.num_falling,
        "strands": {
            verb(robot, "strand_names")(robot)[strand]: {
                "own_least": _of(np.min, found.checks[own].rest.strand_tension[found.checks[own].rest.converged, strand]),
                "least": _of(np.min, choice.check.rest.strand_tension[choice.check.rest.converged, strand]),
                "largest": _of(np.max, choice.check.rest.strand_tension[choice.check.rest.converged, strand]),
            }
            for strand in range(robot.num_strands)
        },
    }  # fmt: skip


def _of(function, values: np.ndarray) -> float:
    return float(function(values)) if values.size else float("nan")
