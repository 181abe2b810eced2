"""The stage on the two-segment arm, with as few compilations of MJX as there are cable models."""

import numpy as np
import pytest

from qjrl import artifacts
from qjrl.config import conf_folder, read_yaml
from qjrl.report.output import write_output
from qjrl.studies.jitter import stage
from qjrl.studies.jitter.cases import HARD, SERVOS, SERVOS_AS_THEY_ARE, JitterConfig

pytestmark = pytest.mark.slow


def test_servos_rest_in_both_engines_and_hard_limits_do_not_in_mjx(tmp_path):
    robot = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    settings = JitterConfig(
        num_poses=1, ramp_time=0.5, hold_time=2.5, window=0.5, half_widths=(1e-4, 1e-3), time_constants=(), impedances=(),
        iteration_counts=(), tolerances=(), averages=(25,),
    )  # fmt: skip
    write_output(stage.run(stage.Config(robot, settings, seed=0), {}, tmp_path), tmp_path)
    cables = artifacts.load(tmp_path / "metrics.json")["sweeps"]["cables"]
    assert cables[SERVOS]["C MuJoCo"]["mean"] < 1e-6
    assert cables[SERVOS]["MJX"]["mean"] < 2e-4
    assert cables[SERVOS]["tips_apart_mm"] < 0.02
    assert cables[SERVOS]["MJX"]["mean"] < 0.5 * cables[SERVOS_AS_THEY_ARE]["MJX"]["mean"]
    assert cables[HARD]["MJX"]["mean"] > 100.0 * cables[HARD]["C MuJoCo"]["mean"]
    norms = artifacts.load(tmp_path / "norms.npz")
    assert norms[f"{SERVOS} / MJX"].shape == (1, 750) and np.isfinite(norms[f"{SERVOS} / MJX"]).all()
    for name in ("norms", "settings", "width"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
