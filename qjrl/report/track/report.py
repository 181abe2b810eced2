"""The page of a followed path: verdict, numbers, animation, figures."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from qjrl.report.html import Number
from qjrl.report.page import Fragment, Picture, Report, Section
from qjrl.report.track.tracked import tracking_table


def track_report(
    title: str,
    metrics: Mapping[str, Any],
    accepted: float,
    animation: Fragment,
    pictures: Mapping[str, tuple[Figure, str]],
) -> Report:
    """The whole page.

    Args:
        metrics: as the stage writes them.
        accepted: 99th percentile of the position error that counts as good [m].
        pictures: name -> figure and caption; the first two take the whole width.
    """
    plan, rest, played = metrics["plan"], metrics["at_rest"], metrics["played"]
    main = played["planned"]
    holds = main["is_finite"] and main["position_p99_mm"] <= 1e3 * accepted and not main["message"]
    return Report(
        title=title,
        headline=headline(metrics, accepted),
        detail=(
            f"Path of {1e3 * plan['length_m']:.0f} mm in {plan['duration_s']:.2f} s, {100 * plan['speed']:.0f} % of the feasible "
            f"speed, feed-forward alone. Median {main['position_median_mm']:.2f} mm, largest {main['position_max_mm']:.2f} mm."
        ),
        holds=holds,
        summary=(
            Number(
                "99 % of the time within", main["position_p99_mm"], "mm", "distance from where the tip should be now"
            ),
            Number("off the path, 99 %", main["across_p99_mm"], "mm", "whatever the time"),
            Number("orientation, 99 %", main["orientation_p99_deg"], "°"),
            Number("at rest on the path", rest["position_p99_mm"], "mm", "99 %: the forward model's own error"),
        ),
        warnings=(f"While moving: {main['message']}.",) if main["message"] else (),
        sections=(
            Section("Watch it", pictures=(Picture(animation, _VIEWER_CAPTION, is_wide=True),)),
            Section(
                "Numbers",
                f"{_TEXT}\n\n{moving_text(played)}",
                numbers=_plan_numbers(plan, rest, main),
                tables=(tracking_table(played),),
            ),
            Section(
                "Pictures",
                pictures=tuple(
                    Picture(figure, caption, is_wide=index < 2)
                    for index, (figure, caption) in enumerate(pictures.values())
                ),
            ),
        ),
    )


def headline(metrics: Mapping[str, Any], accepted: float) -> str:
    """The verdict in one sentence."""
    main = metrics["played"]["planned"]
    if not main["is_finite"]:
        return "The simulation diverged on this trajectory"
    is_within = main["position_p99_mm"] <= 1e3 * accepted
    said = (
        f"The tip {'stays' if is_within else 'does not stay'} within {1e3 * accepted:g} mm of the moving target 99 % of "
        f"the time: {main['position_p99_mm']:.2f} mm"
    )
    return f"{said}, {'but' if is_within else 'and'} {main['message']}" if main["message"] else said


def moving_text(played: Mapping[str, Mapping[str, Any]]) -> str:
    """What strands and motors did in every performance, one line."""
    wrong = {
        name: one["message"] if one["is_finite"] else "the simulation diverged"
        for name, one in played.items()
        if one["message"] or not one["is_finite"]
    }
    said = [f"“{name}”: {message}." for name, message in wrong.items()]
    if len(wrong) < len(played):
        where = "in the others" if wrong else "in any of these"
        said.append(f"No strand went slack or reached its strength and no motor was exceeded {where}.")
    return " ".join(said)


def _plan_numbers(plan: Mapping[str, Any], rest: Mapping[str, Any], main: Mapping[str, Any]) -> tuple[Number, ...]:
    return (
        Number("feasible duration", plan["quickest_s"], "s", f"speed limit alone: {plan['least_s']:.2f} s"),
        Number("cable speed", 100 * plan["cable_speed_share"], "%", "of the motors'"),
        Number("acceleration", 100 * plan["cable_acceleration_share"], "%", "of its limit"),
        Number("jerk", 100 * plan["cable_jerk_share"], "%", "of its limit"),
        Number("error on the model", 1e3 * plan["model_position_max_mm"], "µm", "largest, at all commands"),
        Number("tension at rest", f"{rest['tension_min_N']:.1f}–{rest['tension_max_N']:.1f}", "N"),
        Number("tension while moving", f"{main['tension_min_N']:.1f}–{main['tension_max_N']:.1f}", "N"),
        Number("largest motor force while moving", main["motor_force_max_N"], "N"),
    )


_VIEWER_CAPTION = (
    "The arm as the physics moved it; grey the path, orange where the tip has been. Drag or use the arrow keys to turn, "
    "+ and - to zoom."
)
_TEXT = (
    "“Planned” runs the commands ahead by the arm's lag, as a rehearsal without lead (“without lead”) showed it. “Held commands” lets "
    "the motors jump to each command and stand still until the next, which no motor of this speed can do; “closed form” is the same "
    "path inverted without the learned model. Errors are taken at every time step of the physics between the plan's begin "
    "and its end."
)
