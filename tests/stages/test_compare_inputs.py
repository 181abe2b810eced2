"""What stage `compare` reads of the stages before it, changed by hand: one line before any comparison."""

import functools
import json
from typing import Any

import pytest
from ridge_model import registered

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.config import conf_folder, read_yaml
from qjrl.control.policy_training import PolicyConfig
from qjrl.report.output import write_output
from qjrl.simulation import SettleConfig
from qjrl.stages import compare

ERRORS = {"median_mm": 0.1, "p99_mm": 0.5, "median_deg": None}
RATES = {"steps_per_second": 9e3, "physics_steps_per_second": 3e4, "share_of_physics_rate": 0.3}
STEPS = {"kept_env_steps": 0, "env_steps": 640, "invalid_steps": 0}
MEASURED: dict[str, dict[str, Any]] = {
    "forward_model": {
        "form": "corrected",
        "best_epoch": 10,
        "held_out": ERRORS,
        "nominal": ERRORS,
        "rows": {"fitted": 230, "held_out": 26},
    },
    "ik": {"targets_per_second": 70.0},
    "policy": {**STEPS, **RATES, "base": {"uniform_median_mm": 0.2, "near_home_median_mm": 0.2}},
}
LOGS = {"forward_model": {"epoch": 2, "median_mm": None}, "policy": {"env_steps": 0, "kl": 0.1}}


def keys_of(record: dict[str, Any], above: str = "") -> list[str]:
    below = [keys_of(value, f"{above}{key}.") for key, value in record.items() if isinstance(value, dict)]
    return [f"{above}{key}" for key in record] + [key for keys in below for key in keys]


@pytest.fixture
def compared(tmp_path):
    """Stage `compare` on the measured numbers of a small run, and nothing else."""
    inputs = {stage: tmp_path / stage for stage in ("sample", *MEASURED)}
    for stage, numbers in MEASURED.items():
        artifacts.write_json(inputs[stage] / "metrics.json", numbers)
    for stage, record in LOGS.items():
        artifacts.append_json_line(inputs[stage] / "progress.jsonl", record)
    robot = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    config = compare.Config(robot, SettleConfig(), PolicyConfig(), "tiny", seed=0)
    return tmp_path, lambda: write_output(compare.run(config, inputs, tmp_path / "compare"), tmp_path / "compare")


def test_whole_numbers_are_read_and_then_the_targets(compared) -> None:
    with pytest.raises(ArtifactError, match=r"held_out\.npz: does not exist"):
        compared[1]()


def test_a_model_that_is_not_fitted_in_epochs_has_no_log_and_no_best_epoch(compared) -> None:
    folder, run = compared
    path, measured = folder / "forward_model" / "metrics.json", MEASURED["forward_model"]
    (folder / "forward_model" / "progress.jsonl").unlink()
    common = {key: measured[key] for key in ("held_out", "nominal", "rows")}
    with registered():
        artifacts.write_json(path, {"kind": "ridge", **common})
        with pytest.raises(ArtifactError, match=r"held_out\.npz: does not exist"):
            run()
        artifacts.write_json(path, {"kind": "network", **common})
        with pytest.raises(ArtifactError, match=r"measured numbers \(form is missing\)"):
            run()


@pytest.mark.parametrize("stage", MEASURED)
def test_a_key_that_is_gone_or_holds_something_else_is_one_line(compared, stage) -> None:
    folder, run = compared
    path = folder / stage / "metrics.json"
    for key in keys_of(MEASURED[stage]):
        *above, last = key.split(".")
        for value in ([], "x" if last != "form" else 3, None):
            content = json.loads(json.dumps(MEASURED[stage]))
            holder = functools.reduce(lambda one, name: one[name], above, content)
            if value is None:  # of a policy without "base" the errors of the untrained one are asked for
                del holder[last]
            else:
                holder[last] = value
            path.write_text(json.dumps(content))
            named = "untrained" if key == "base" and value is None else key
            with pytest.raises(ArtifactError) as error:
                run()
            assert str(error.value).startswith(f"{path}: is not a file of measured numbers ({named} is "), key
            assert "\n" not in str(error.value)


@pytest.mark.parametrize("stage", LOGS)
@pytest.mark.parametrize(
    "line", ["", "[]", "{}", '{"epoch": "x", "env_steps": 1}', '{"epoch": 1, "env_steps": []}', "{"]
)
def test_a_log_that_holds_no_numbers_is_one_line(compared, stage, line) -> None:
    folder, run = compared
    (folder / stage / "progress.jsonl").write_text(line + "\n")
    with pytest.raises(ArtifactError, match=rf"{stage}/progress\.jsonl"):
        run()


def test_a_policy_and_a_model_that_are_described_otherwise_are_one_line(tmp_path) -> None:
    import numpy as np

    from qjrl.learning.ppo.policy import load_policy
    from qjrl.robot import load_robot, robot_hash
    from qjrl.robot.forward_model import load_forward_model

    robot = load_robot("qj_22")
    artifacts.write_arrays(
        tmp_path / "policy.npz", {"layers/a/bias": np.zeros(2), "mean": np.zeros(2), "std": np.ones(2)}
    )
    names = ("parameters/a", "output_mean", "output_std")
    artifacts.write_arrays(tmp_path / "model.npz", {name: np.zeros(2) for name in names})
    whole = {"activation": "swish", "observation_clip": 10.0}
    for change in ({"activation": "x"}, {"activation": 3}, {"observation_clip": "x"}, None):
        content = {"activation": "swish"} if change is None else whole | change
        artifacts.write_json(tmp_path / "policy.json", content)
        with pytest.raises(ArtifactError, match=r"policy\.json: .*(activation|observation_clip)"):
            load_policy(tmp_path / "policy")
    artifacts.write_json(tmp_path / "policy.json", whole)
    assert load_policy(tmp_path / "policy").observation_clip == 10.0
    for config in (None, [], {"form": "x"}, {"network": 3}, {"new": 1}):
        artifacts.write_json(tmp_path / "model.json", {"robot_hash": robot_hash(robot), "config": config})
        with pytest.raises(ArtifactError, match=r"model\.json: .*config"):
            load_forward_model(tmp_path / "model", robot)
    for name in ("policy", "model"):
        artifacts.write_arrays(tmp_path / f"{name}.npz", {"other": np.zeros(2)})
    with pytest.raises(ArtifactError, match=r"policy\.npz: .*layers, mean, std is missing"):
        load_policy(tmp_path / "policy")
    with pytest.raises(ArtifactError, match=r"model\.npz: .*parameters, output_mean, output_std is missing"):
        artifacts.write_json(tmp_path / "model.json", {"robot_hash": robot_hash(robot), "config": {}})
        load_forward_model(tmp_path / "model", robot)
