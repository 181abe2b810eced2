"""The verdict of a followed path."""

from typing import Any

import numpy as np
import pytest

from qjrl.report.page import Fragment, report_page
from qjrl.report.track.report import headline, moving_text, track_report
from qjrl.report.track.tracked import Tracked, tracked_metrics

SLACK = "strand_3_b goes slack at 0.42 s, for 0.030 s in all"


def metrics(message: str = "", position: float = 5e-4, other: str = "", is_finite: bool = True) -> dict[str, Any]:
    """A tip that is off by `position` [m] all the time."""
    off, still = np.full(10, position), np.zeros(10)
    run = Tracked(
        0.5, 0.0, 0.1 * np.arange(10), off, off, still, still, np.ones(10), np.ones((10, 8)), np.ones((10, 4))
    )
    played = tracked_metrics(run) | {"is_finite": is_finite}
    plan = {"length_m": 0.3, "duration_s": 2.0, "speed": 0.5, "quickest_s": 1.0, "least_s": 0.5}
    shares = {f"cable_{name}_share": 0.4 for name in ("speed", "acceleration", "jerk")}
    return {
        "plan": plan | shares | {"model_position_max_mm": 0.001},
        "at_rest": {"position_p99_mm": 0.1, "tension_min_N": 10.0, "tension_max_N": 20.0},
        "played": {"planned": played | {"message": message}, "without lead": played | {"message": other}},
    }


def page(content: dict[str, Any]):
    return track_report("Path", content, 1e-3, Fragment(""), {})


def test_a_path_that_is_kept_by_taut_strands_is_good_news() -> None:
    assert headline(metrics(), 1e-3) == "The tip stays within 1 mm of the moving target 99 % of the time: 0.50 mm"
    assert page(metrics()).holds and not page(metrics()).warnings
    assert moving_text(metrics()["played"]).endswith("no motor was exceeded in any of these.")


def test_a_strand_that_goes_slack_while_moving_is_bad_news_however_small_the_error() -> None:
    said = page(metrics(SLACK))
    assert said.holds is False and said.headline.endswith(f"0.50 mm, but {SLACK}")
    assert said.warnings == (f"While moving: {SLACK}.",)
    assert SLACK in report_page(said)
    assert headline(metrics(SLACK, 2e-3), 1e-3).endswith(f"2.00 mm, and {SLACK}")


def test_what_goes_wrong_in_a_comparison_is_told_and_leaves_the_verdict() -> None:
    content = metrics(other=SLACK)
    assert page(content).holds
    assert moving_text(content["played"]) == (
        f"“without lead”: {SLACK}. No strand went slack or reached its strength and no motor was exceeded in the others."
    )


@pytest.mark.parametrize("message", ["", SLACK])
def test_a_simulation_that_diverged_is_said_to_have(message: str) -> None:
    content = metrics(message, is_finite=False)
    assert headline(content, 1e-3) == "The simulation diverged on this trajectory"
    assert page(content).holds is False and "taut" not in moving_text(content["played"])
    assert "No strand" not in moving_text(content["played"])
