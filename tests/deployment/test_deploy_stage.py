"""The stage as the command runs it: files, record, numbers, page; then the replay of its own record."""

import dataclasses

import numpy as np
import pytest
from controllers import CONFIG, policy, targets

from qjrl import artifacts, pipeline
from qjrl.artifacts import ArtifactError, hash_of_file
from qjrl.config import ConfigError, as_mapping, conf_folder, read_yaml
from qjrl.control.policy_training import PolicyConfig
from qjrl.deployment.controller_export import ControllerExportConfig
from qjrl.deployment.deploy import DeployConfig
from qjrl.learning.ppo.policy import save_policy
from qjrl.simulation.settle_problem import SettleConfig

SETTINGS = DeployConfig(num_targets=1, files=ControllerExportConfig(onnx=False, platforms=("cpu",)))


def run_stage(directory, **changes):
    """The stage alone in a run directory that has its inputs."""
    tree = {
        "robot": read_yaml(conf_folder() / "robot" / "qj_22.yaml"),
        "simulation": as_mapping(SettleConfig()),
        "policy": as_mapping(PolicyConfig(base="dither_integral", environment=CONFIG)),
        "deploy": as_mapping(dataclasses.replace(SETTINGS, **changes)),
        "seed": 0,
    }
    config = pipeline.build(pipeline.STAGES["deploy"].load().Config, tree)
    config.check()
    pipeline.run(["deploy"], {"deploy": config}, directory)
    return directory / "deploy"


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    directory = tmp_path_factory.mktemp("run")
    target, lengths = targets()
    artifacts.write_arrays(directory / "ik" / "held_out.npz", {"target": target, "learned_lengths": lengths})
    save_policy(directory / "policy" / "policy", policy())
    for name in ("ik", "policy"):
        artifacts.mark_done(directory / name)
    return directory


@pytest.mark.slow
def test_a_deployment_is_written_whole_and_its_replay_is_exact(run_dir):
    out = run_stage(run_dir)
    contract, metrics = (artifacts.load(out / f"{name}.json") for name in ("contract", "metrics"))
    assert set(contract["functions"]) == {"begin_target", "control_step"}
    for function in contract["functions"].values():
        assert all(about["sha256"] == hash_of_file(out / name) for name, about in function["files"].items())
    assert contract["motors"]["pulley_radius"]["unit"] == "m" and contract["protocol"]["faults"]
    assert metrics["replay"]["command_deviation"] == 0.0 and metrics["replay"]["flags_that_differ"] == 0
    assert metrics["timing"]["periods"] + metrics["timing"]["periods_lost"] == 2 * CONFIG.episode_steps
    assert [one["name"] for one in metrics["episodes"]] == ["target 1", "target 1 with faults"]
    assert "canvas" in (out / "deploy.html").read_text() and (out / "latency.png").stat().st_size > 1000

    played = artifacts.load(out / "log.npz")
    again = run_stage(run_dir, replay=str(out / "log.npz"))
    measured = artifacts.load(again / "metrics.json")
    for part in ("timing", "episodes", "replay"):  # nothing was played: the same record, the same numbers
        assert measured[part] == metrics[part]
    np.testing.assert_array_equal(artifacts.load(again / "log.npz")["command"], played["command"])


def test_bad_input_is_one_line(run_dir):
    with pytest.raises(ArtifactError, match=r"deploy.num_targets: got 3, allowed: at most the 2 held-out targets"):
        run_stage(run_dir, num_targets=3)
    with pytest.raises(ConfigError, match=r"deploy.replay: nowhere.npz does not exist"):
        run_stage(run_dir, replay="nowhere.npz")
