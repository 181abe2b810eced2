import dataclasses

import numpy as np
import pytest
from test_policy_training import NUM_ENVS, POLICY, PPO, columns
from worlds import ARM

from qjrl.artifacts import load
from qjrl.control.policy_training import train_policy
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.simulation import mjx_stepping
from qjrl.simulation.settle_problem import SettleConfig


@pytest.mark.slow
def test_one_iteration_of_ppo_trains_in_mjx(tmp_path, monkeypatch):
    made, stepper = [], mjx_stepping.MjxStepper
    monkeypatch.setattr(mjx_stepping, "MjxStepper", lambda *args: made.append(args[1]) or stepper(*args))
    ppo = dataclasses.replace(PPO, num_steps=PPO.unroll_length * NUM_ENVS, checkpoint_every=1)
    config = dataclasses.replace(POLICY, engine="simulation", ppo=ppo)
    policy = train_policy(ARM, SettleConfig(backend="mjx"), config, columns(), 0, tmp_path).policy
    assert made == [2, NUM_ENVS]  # the judge's arms and those trained on
    before, after = load(tmp_path / "progress.jsonl")
    assert (after["iteration"], after["env_steps"], after["invalid"]) == (1, ppo.num_steps, 0)
    assert np.isfinite(after["policy_loss"]) and after["evaluation/median_mm"] != before["evaluation/median_mm"]
    seen = np.ones((1, policy.mean.shape[0]), np.float32)
    is_better = after["evaluation/median_mm"] < before["evaluation/median_mm"]
    assert np.any(deterministic_action(policy, seen)) == is_better
