import dataclasses
import importlib.util

import numpy as np
import pytest
from test_policy_training import NUM_ENVS, POLICY, PPO, columns
from worlds import ARM

from qjrl.artifacts import load
from qjrl.control import policy_training
from qjrl.control.policy_training import train_policy
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.mjx_engine import MjxEngine

needs_warp = pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="pip install 'qjrl[warp]'")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mjx", pytest.param("mjx-warp", marks=needs_warp)])
def test_one_iteration_of_ppo_trains_in_mjx(tmp_path, monkeypatch, kind):
    made, make = [], policy_training.residual_env
    monkeypatch.setattr(policy_training, "residual_env", lambda *parts: made.append(parts[-1]) or make(*parts))
    ppo = dataclasses.replace(PPO, num_steps=PPO.unroll_length * NUM_ENVS, checkpoint_every=1)
    config = dataclasses.replace(POLICY, ppo=ppo)
    policy = train_policy(ARM, EngineConfig(kind, 0.004), config, columns(), 0, tmp_path).policy
    assert [type(engine) for engine in made] == [MjxEngine]
    before, after = load(tmp_path / "progress.jsonl")
    assert (after["iteration"], after["env_steps"], after["invalid"]) == (1, ppo.num_steps, 0)
    assert np.isfinite(after["policy_loss"]) and after["evaluation/median_mm"] != before["evaluation/median_mm"]
    seen = np.ones((1, policy.mean.shape[0]), np.float32)
    is_better = after["evaluation/median_mm"] < before["evaluation/median_mm"]
    assert np.any(deterministic_action(policy, seen)) == is_better
