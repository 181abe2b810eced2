"""The stage on the two-segment arm at the smallest size, over the workspace and along a path."""

import numpy as np
import pytest

from qjrl import artifacts, pipeline
from qjrl.config import ConfigError, as_mapping, build, conf_folder, read_yaml
from qjrl.control.tension.pretension import PretensionConfig
from qjrl.provenance import provenance
from qjrl.report.output import Output, write_output
from qjrl.simulation import SettleConfig
from qjrl.stages import pretension as stage


def run(out, **changes):
    robot = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    settings = PretensionConfig(
        num_poses=8, pretensions=(5.0, 30.0), resolution=1.0, num_angles=2, num_directions=3, **changes
    )
    artifacts.write_json(out / artifacts.PROVENANCE, provenance({}, 0, None))
    write_output(stage.run(stage.Config(robot, SettleConfig(batch_size=32), settings, seed=0), {}, out), out)
    return artifacts.load(out / "metrics.json")


def test_the_workspace_has_an_answer_a_curve_maps_and_a_page(tmp_path, caplog):
    with caplog.at_level("INFO"):
        metrics = run(tmp_path)
    answer = metrics["least_pretension"]
    assert 5.0 < answer < 30.0 and metrics["override"] == f"robot.strands.pretension={answer:g}"
    assert metrics["override"] in caplog.text and metrics["override"] in (tmp_path / "report.html").read_text()
    curve = {row["pretension"]: row for row in metrics["curve"]}
    assert list(curve) == sorted({5.0, 15.0, 30.0, answer})
    assert curve[answer]["safe_share"] == 1.0 and curve[answer]["least_tension"] >= 2.0
    assert curve[5.0]["safe_share"] < 1.0 and curve[5.0]["least_tension"] < 2.0
    assert metrics["fresh"]["poses"] == 8 and 0.0 <= metrics["fresh"]["safe_share"] <= 1.0
    arrays = artifacts.load(tmp_path / "tensions.npz")
    assert arrays["strand_tension"].shape == (8, 8) and arrays["lowest_tension"].shape == (3, 8)
    assert arrays["strand_tension"].min() == pytest.approx(curve[answer]["least_tension"])
    for name in ("trade_offs", "tip_map", "segment_map"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_path_that_no_pretension_keeps_is_named(tmp_path):
    lengths = np.linspace(0.0, 1.0, 5)[:, None] * np.array([0.01, 0.0, 0.02, 0.0])
    artifacts.write_arrays(tmp_path / "trajectory.npz", {"cable_lengths": lengths})
    metrics = run(tmp_path, path=str(tmp_path / "trajectory.npz"), least_tension=500.0)
    assert metrics["least_pretension"] is None and metrics["override"] == "" and "fresh" not in metrics
    assert metrics["at"]["message"].startswith("5 of 5 rows are not safe to play: strand_")
    assert "No pretension up to 30 N keeps every pose safe along" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "path.png").exists() and not (tmp_path / "tip_map.png").exists()


def test_another_path_in_the_same_file_runs_the_stage_again(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(stage, "run", lambda config, inputs, out: Output())
    file, robot = tmp_path / "path.csv", read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    for row in ("0.01,0,0.02,0", "0.01,0,0.02,0", "0.02,0,0.02,0"):
        file.write_text(f"1,5,3,7\n0,0,0,0\n{row}\n")
        config = stage.Config(robot, SettleConfig(), PretensionConfig(path=str(file)), seed=0)
        with caplog.at_level("INFO"):
            pipeline.run(["pretension"], {"pretension": config}, tmp_path / "run")
    said = [line for line in caplog.messages if line.startswith("pretension: ")]
    assert said[0] == "pretension: starts" and said[1] == "pretension: done before and unchanged, skipped"
    assert said[2].startswith("pretension: configuration or inputs changed")
    assert stage.Config(robot, SettleConfig(), PretensionConfig(), seed=0).files == {}


def test_a_bad_path_is_refused_before_any_work(tmp_path):
    tree = {"robot": read_yaml(conf_folder() / "robot" / "qj_22.yaml"), "simulation": {}, "seed": 0}
    (tmp_path / "short.csv").write_text("0,0,0\n")
    for path, words in {
        "nowhere.csv": "cannot be read",
        str(tmp_path / "short.csv"): "has no header, its first line is numbers",
    }.items():
        with pytest.raises(ConfigError, match=rf"^pretension\.path: .*{words}"):
            build(stage.Config, tree | {"pretension": as_mapping(PretensionConfig()) | {"path": path}}).check()
