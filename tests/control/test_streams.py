"""The streams of random numbers of a training: no two are the same, and none is a child of another."""

import contextlib

import jax
import numpy as np
from worlds import ARM

from qjrl.control import policy_training
from qjrl.keys import key_for, seed_for


def test_the_arms_of_a_training_have_no_key_of_its_networks_or_of_its_actions(monkeypatch, tmp_path):
    """What `train_policy` hands to the environment: an arm's key is folded from the stream of the training arms."""
    seen = {}

    def keep(robot, config, bank, stepper, seed, rows=None, first=0):
        seen["evaluated" if rows is not None else "trained"] = seed
        raise StopIteration

    monkeypatch.setattr(policy_training, "ResidualEnvironment", keep)
    monkeypatch.setattr(policy_training, "Judge", lambda *arguments: seen.update(evaluated=arguments[-1]))
    from test_policy_training import POLICY, columns

    from qjrl.simulation.settle_problem import SettleConfig

    with contextlib.suppress(StopIteration):
        policy_training.train_policy(ARM, SettleConfig(), POLICY, columns(), 0, tmp_path)
    assert seen == {
        "trained": seed_for(0, "training arms"),
        "evaluated": seed_for(0, "arms of the checkpoints' evaluation"),
    }
    arms = jax.random.key_data(jax.random.split(jax.random.key(seen["trained"]), 2048))
    own = [jax.random.key_data(key_for(0, purpose)) for purpose in ("networks", "actions and minibatches", "dagger")]
    of_ppo = jax.random.key_data(jax.random.split(key_for(0, "actions and minibatches"), 3))
    rows = np.concatenate([arms, np.stack(own), of_ppo])
    assert len(np.unique(rows, axis=0)) == len(rows)
