"""The jitter study in numbers: `metrics.json`, its tables, the verdict."""

from typing import Any

import numpy as np

from qjrl.report.tables import Column, Table
from qjrl.studies.jitter.cases import HARD, SERVOS, SERVOS_AS_THEY_ARE, TIMESTEP, Case, JitterConfig, sweeps
from qjrl.studies.jitter.measure import ENGINES, Findings, Motion

MOST_AT_REST = {"C MuJoCo": 1e-6, "MJX": 2e-4}
"""Mean |joint velocity| [rad/s] that the servos are to stay below at rest."""


def metrics_of(config: JitterConfig, findings: Findings) -> dict[str, Any]:
    """Everything measured, SI units and millimetres where named, for `metrics.json`."""
    found = {
        name: {label: _case_metrics(config, findings, case) for label, case in sweep.items()}
        for name, sweep in sweeps(config).items()
    }
    step = np.abs(findings.commands.cable_lengths).max() / config.ramp_time
    return {
        "verdict": verdict(found["cables"]),
        "poses": config.num_poses,
        "most_at_rest": MOST_AT_REST,
        "fastest_cable": float(step),
        "sweeps": found,
    }


def verdict(cables: dict[str, Any]) -> str:
    """In words, whether the servos rest, and what the limits do beside them."""
    parts = []
    for engine, most in MOST_AT_REST.items():
        ours, theirs = cables[SERVOS][engine]["mean"], cables[HARD][engine]["mean"]
        if ours is None:
            parts.append(f"{engine}: the servos diverged")
            continue
        word = "met" if ours <= most else f"missed by a factor of {ours / most:.2g}"
        limits = "diverge" if theirs is None else f"{theirs:.1e}"
        parts.append(f"{engine}: servos {ours:.1e} rad/s at rest ({word}: at most {most:g}), hard limits {limits}")
    own = cables[SERVOS_AS_THEY_ARE]["MJX"]["mean"]
    parts.append(f"servos in MJX's own step {'diverge' if own is None else f'{own:.1e}'}")
    return "; ".join(parts) + "."


def speed_table(metrics: dict[str, Any]) -> Table:
    """One row a case: speeds at rest in both engines, where the tip rests, how far it gives way."""
    columns = (
        Column("setting"), Column("value"),
        *(Column(f"{engine} {what}", unit="rad/s") for engine in ENGINES for what in ("mean", "peak")),
        Column("from nominal", 2, "mm"), Column("gives way", 2, "mm"),
    )  # fmt: skip
    rows = []
    for name, sweep in metrics["sweeps"].items():
        for label, case in sweep.items():
            speeds = [_speed(case[engine][what]) for engine in ENGINES for what in ("mean", "peak")]
            rows.append((name, label, *speeds, case["from_nominal_mm"], case["deflection_mm"]))
    note = (
        "mean |joint velocity| over joints and window, mean over poses; peak: the largest mean over the joints at one step; "
        "from nominal, gives way: means in C MuJoCo at the end"
    )
    return Table(columns, tuple(rows), note=note)


def average_table(config: JitterConfig, metrics: dict[str, Any]) -> Table:
    """What a moving average over the joint velocities leaves in MJX, and what it costs in delay."""
    columns = (Column("cables"), Column("as it is", unit="rad/s"), *(
        Column(f"{width} steps, {1e3 * delay_of(width):.0f} ms late", unit="rad/s") for width in config.averages
    ))  # fmt: skip
    rows = tuple(
        (label, _speed(case["MJX"]["mean"]), *(_speed(value) for value in case["MJX"]["averaged"]))
        for label, case in metrics["sweeps"]["cables"].items()
    )
    return Table(columns, rows)


def delay_of(width: int) -> float:
    """By how much the mean over the last `width` steps is late [s]."""
    return 0.5 * (width - 1) * TIMESTEP


def _case_metrics(config: JitterConfig, findings: Findings, case: Case) -> dict[str, Any]:
    motions = findings.motions[case]
    distance = np.linalg.norm(motions["C MuJoCo"].tip - findings.commands.nominal_tip, axis=1)
    return {
        "half_width": case.half_width if case.cables == "limits" else None,
        **{engine: _motion_metrics(config, motion) for engine, motion in motions.items()},
        "tips_apart_mm": _mean(1e3 * np.linalg.norm(motions["MJX"].tip - motions["C MuJoCo"].tip, axis=1)),
        "from_nominal_mm": _mean(1e3 * distance),
        "deflection_mm": _mean(1e3 * findings.deflections[case]) if case in findings.deflections else None,
    }


def _motion_metrics(config: JitterConfig, motion: Motion) -> dict[str, Any]:
    """Over the poses that did not diverge; None where all did."""
    good = np.isfinite(motion.mean_speed)
    return {
        "mean": _mean(motion.mean_speed[good]),
        "peak": float(motion.peak_speed[good].max()) if good.any() else None,
        "diverged": int((~good).sum()),
        "averaged": [_mean(motion.averaged_speed[good, index]) for index in range(len(config.averages))],
    }


def _mean(values: np.ndarray) -> float | None:
    """Of the finite values; JSON knows no NaN."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else None


def _speed(value: float | None) -> str:
    return "diverged" if value is None else f"{value:.1e}"
