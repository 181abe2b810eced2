"""The stage `track` on the two-segment arm, with a model that has not been trained."""

import dataclasses
import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl import artifacts, pipeline
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, as_mapping, build, conf_folder, read_yaml
from qjrl.control.path.inversion import PathInversionConfig
from qjrl.control.path.paths import ShapeConfig
from qjrl.control.tracking.playing import TrackConfig
from qjrl.learning.fitting import FittedNetwork
from qjrl.learning.networks import NetworkConfig
from qjrl.robot import load_robot, robot_hash
from qjrl.robot.forward_model import ForwardModel, ForwardModelConfig, make_network, save_forward_model
from qjrl.simulation import SettleConfig
from qjrl.stages import track

ARM = load_robot("qj_22")
ROBOT = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
POINTS = "x,y,z\n-0.02,0,0.225\n0,0.01,0.23\n0.02,0,0.225\n"
SETTINGS = TrackConfig(
    shape=ShapeConfig(spacing=0.003), inversion=PathInversionConfig(num_starts=2), compared_speeds=(1.0,)
)


def config(path, **changes):
    return track.Config(ROBOT, SettleConfig(), dataclasses.replace(SETTINGS, path=str(path), **changes), seed=0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A path in a file and a forward model that is the closed form."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "path.csv").write_text(POINTS)
    settings = ForwardModelConfig(
        "corrected", NetworkConfig(width=8, num_blocks=1, num_frequencies=1, zero_output=True)
    )
    network = make_network(ARM, settings)
    parameters = jax.jit(network.init)(jax.random.key(0), jnp.zeros((1, ARM.num_cables), jnp.float32))["params"]
    size = network.output_size
    fitted = FittedNetwork(parameters, jnp.zeros(size, jnp.float32), jnp.ones(size, jnp.float32))
    save_forward_model(folder / "forward_model" / "model", ARM, ForwardModel(fitted, settings))
    artifacts.mark_done(folder / "forward_model", robot_hash=robot_hash(ARM))
    return folder


@pytest.mark.slow
def test_a_file_is_followed_and_everything_promised_is_written(folder, caplog) -> None:
    settings = config(folder / "path.csv")
    with caplog.at_level(logging.INFO):
        pipeline.run(["track"], {"track": settings}, folder)
        pipeline.run(["track"], {"track": settings}, folder)
    assert "track: done before and unchanged, skipped" in caplog.text
    out = folder / "track"
    metrics, raw = artifacts.load(out / "metrics.json"), artifacts.load(out / "trajectory.npz")
    plan, main = metrics["plan"], metrics["played"]["planned"]
    assert plan["counts"] == "position" and plan["model_position_max_mm"] < 0.01
    assert max(plan[f"cable_{name}_share"] for name in ("speed", "acceleration", "jerk")) <= 0.5
    moving = (raw["played_time"] >= 0) & (raw["played_time"] <= plan["duration_s"])
    assert main["position_p99_mm"] == pytest.approx(1e3 * np.percentile(raw["position_error"][moving], 99))
    assert metrics["played"].keys() == {
        "planned",
        "held commands",
        "closed form",
        "at 1 of the feasible speed",
        "without lead",
    }
    assert abs(main["lag_ms"]) < abs(metrics["played"]["without lead"]["lag_ms"])
    np.testing.assert_allclose(raw["planned_pose"][[0, -1], :3], [[-0.02, 0, 0.225], [0.02, 0, 0.225]], atol=1e-9)
    assert [one["breaches"] for one in metrics["played"].values()] == [[]] * 5 and main["message"] == ""
    page = (out / "track.html").read_text()
    assert "No strand went slack or reached its strength and no motor was exceeded in any of these." in page
    assert "<canvas" in page and "http://" not in page.replace("http://www.w3.org", "")
    assert all(
        (out / f"{name}.png").stat().st_size > 8000 for name in ("path", "cables", "error", "orientation", "tension")
    )

    (folder / "path.csv").write_text(POINTS.replace("0.01", "0.012"))
    caplog.clear()
    with caplog.at_level(logging.INFO), pytest.raises(ConfigError, match="not safe to play: strand"):
        pipeline.run(["track"], {"track": config(folder / "path.csv", least_tension=100.0)}, folder)
    assert "track: configuration or inputs changed" in caplog.text
    assert not list(out.glob("*.npz")) and not list(out.glob("*.html"))


def test_the_content_of_a_path_file_belongs_to_the_identity_of_the_stage(folder, tmp_path) -> None:
    file = tmp_path / "path.csv"
    file.write_text(POINTS)
    before = config(file).files
    file.write_text(POINTS.replace("0.01", "0.011"))
    assert before.keys() == config(file).files.keys() and before != config(file).files
    assert config("line").files == {}


def test_a_bad_path_is_refused_before_anything_is_written(tmp_path) -> None:
    tree = {"robot": ROBOT, "simulation": {}, "seed": 0}
    for path, words in {"nowhere.csv": "nowhere.csv: cannot be read", "spiral": "track.path: got 'spiral'"}.items():
        with pytest.raises(ConfigError, match=words):
            build(track.Config, tree | {"track": as_mapping(SETTINGS) | {"path": path}}).check()
    with pytest.raises(ArtifactError, match=r"track: needs .*forward_model, which does not exist"):
        pipeline.run(["track"], {"track": config("line")}, tmp_path)
    assert not (tmp_path / "track").exists()
