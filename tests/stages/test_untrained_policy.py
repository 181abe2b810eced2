"""What the stages say of a policy that no training made better: its base, or noise on top of it."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from qjrl import artifacts
from qjrl.config import conf_folder, read_yaml
from qjrl.control.policy_training import PHYSICS_RATES, PolicyConfig
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.config import PPOConfig
from qjrl.report.compare.page import policy_section
from qjrl.report.outcomes import Outcome
from qjrl.report.output import write_output
from qjrl.simulation import SettleConfig
from qjrl.simulation.engine import EngineConfig
from qjrl.stages import compare, policy

ROBOT = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
MEDIANS = {"uniform_median_mm": 20.0, "near_home_median_mm": 30.0}


def of_stage(stage: Any, starts_at_zero: bool) -> Any:
    config = PolicyConfig(ppo=PPOConfig(starts_at_zero=starts_at_zero))
    physics = {"simulation": SettleConfig(), "name": "run"} if stage is compare else {"engine": EngineConfig()}
    return stage.Config(robot=ROBOT, policy=config, seed=0, **physics)


@pytest.fixture
def trained(tmp_path, monkeypatch, caplog):
    """`policy/metrics.json` of a training whose best checkpoint is the one before the first iteration, and the log."""

    @dataclasses.dataclass
    class Trained:
        left_out = dict.fromkeys(TARGET_SETS, 0)

    def train_policy(*arguments):
        out = arguments[-1]
        for steps, median, more in ((0, 25.0, {}), (640, 40.0, {"steps_per_second": 9.0})):
            evaluated = {f"evaluation/{name}": value for name, value in (MEDIANS | {"median_mm": median}).items()}
            artifacts.append_json_line(
                out / "progress.jsonl", {"iteration": 0, "env_steps": steps, **evaluated, **more}
            )
            artifacts.append_json_line(out / PHYSICS_RATES, {"env_steps": steps, "physics_steps_per_second": 10.0})
        return Trained()

    def run(starts_at_zero: bool) -> tuple[dict[str, Any], str]:
        artifacts.write_arrays(
            tmp_path / "ik" / "bank.npz",
            dict.fromkeys(("target", "target_set", "nominal_lengths", "learned_lengths"), np.zeros((1, 9))),
        )
        monkeypatch.setattr(policy, "train_policy", train_policy)
        (tmp_path / "policy").mkdir()
        with caplog.at_level("INFO"):
            output = policy.run(of_stage(policy, starts_at_zero), {"ik": tmp_path / "ik"}, tmp_path / "policy")
            write_output(output, tmp_path / "policy")
        return artifacts.load(tmp_path / "policy" / "metrics.json"), caplog.text

    return run


@pytest.mark.parametrize(
    ("starts_at_zero", "name", "said"), [(True, "base", "base"), (False, "untrained", "untrained policy")]
)
def test_only_a_policy_that_starts_at_zero_is_called_its_base(trained, tmp_path, starts_at_zero, name, said):
    metrics, log = trained(starts_at_zero)
    assert metrics["kept_env_steps"] == 0
    assert {"base", "untrained"} & metrics.keys() == {name} and metrics[name] == MEDIANS
    assert f"no trained checkpoint beats the {said} on the evaluated targets" in log
    figure: Any = policy_section(artifacts.load(tmp_path / "policy" / "progress.jsonl"), metrics).pictures[0].content
    shown = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert shown[-2:] == [f"{said}, uniform bends", f"{said}, near home"]


def outcomes(base_mm: float, policy_mm: float) -> list[Outcome]:
    tension = np.full((20, 8), 15.0)
    return [
        Outcome(name, target_set, error := np.full(20, 1e-3 * millimetres), error, tension, tension < 0.01, 0)
        for target_set in TARGET_SETS
        for name, millimetres in (
            ("learned_ik+dither+estimate", base_mm),
            ("learned_ik+dither+estimate+residual", policy_mm),
        )
    ]


def test_the_verdict_on_noise_that_was_kept_stands(trained):
    metrics, _ = trained(False)
    verdict = compare._verdict(of_stage(compare, False), outcomes(1.0, 20.0), metrics)
    assert verdict.holds is False and "equals its base" not in verdict.headline


def test_a_policy_that_is_its_base_is_not_praised(trained):
    metrics, _ = trained(True)
    verdict = compare._verdict(of_stage(compare, True), outcomes(1.0, 1.0), metrics)
    assert verdict.holds is None and "equals its base" in verdict.headline
