import dataclasses
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from customary import customary_ppo
from worlds import ARM, CONFIG, ENGINE, assert_same_bits, bank, rows_of

from qjrl.artifacts import load
from qjrl.config import ConfigError
from qjrl.control import policy_training
from qjrl.control.environment import residual_env
from qjrl.control.policy_training import PHYSICS_RATES, PolicyConfig, train_policy
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.learning.ppo.train import train as train_ppo
from qjrl.simulation.engines import make_engine

ITERATIONS, NUM_ENVS = 4, 4
PPO = customary_ppo(
    num_steps=ITERATIONS * 8 * NUM_ENVS,
    unroll_length=8,
    num_epochs=2,
    num_minibatches=2,
    actor_layers=(16,),
    critic_layers=(16,),
    checkpoint_every=2,
)
POLICY = PolicyConfig(num_envs=NUM_ENVS, num_evaluated=1, environment=CONFIG, ppo=PPO)


def columns():
    """Columns of `ik/bank.npz`; the last target of the first set is out of reach in time."""
    targets = bank()
    lengths = np.array(targets.base_lengths)
    lengths[3] *= 100.0
    return {
        "target_set": np.repeat([0, 1], 4),
        "target": np.asarray(targets.target),
        "nominal_lengths": lengths,
        "learned_lengths": lengths,
    }


def interrupt_at(iteration):
    def callback(record):
        if record["iteration"] == iteration:
            raise KeyboardInterrupt

    return callback


def train(directory, **options):
    """On five targets, as many as `train_policy` has left of `columns`, so that both share their programs."""
    env = residual_env(ARM, CONFIG, rows_of(bank(), range(5)), make_engine(ARM, ENGINE))
    return train_ppo(env, PPO, NUM_ENVS, 0, directory, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("whole")
    return train(directory), directory


def arms_in(checkpoints) -> dict[str, np.ndarray]:
    """Path -> array of the environments in the last checkpoint."""
    packed = np.asarray(checkpoints[str(ITERATIONS)]["environment"]["npz"])
    return dict(np.load(io.BytesIO(packed.tobytes())))


@pytest.mark.parametrize("iteration", [1, 3])  # before the first checkpoint after the start, and between two
def test_a_training_resumed_on_the_real_arm_equals_an_uninterrupted_one_bit_for_bit(whole, tmp_path, iteration):
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, callbacks=[interrupt_at(iteration)])
    policy = train(tmp_path)
    expected, directory = whole
    assert_same_bits(policy, expected)
    one, other = load(tmp_path / "checkpoints"), load(directory / "checkpoints")
    assert_same_bits(one, other)
    assert {"envs/inner/plant/state/moving/half_angles", "envs/inner/episode/key"} <= arms_in(one).keys()


@pytest.mark.slow
def test_20_kills_at_random_moments_change_nothing(tmp_path):
    """Each process is the real one: killed before its first record, or within half a second after one of its first three."""
    program = Path(__file__).with_name("killed_training.py")
    cache = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "xla")}
    paths = os.pathsep.join(str(folder) for folder in (program.parents[2], program.parents[1], program.parent))
    environ = os.environ | cache | {"PYTHONPATH": paths, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    log = tmp_path / "killed" / "progress.jsonl"

    def begin(name):
        return subprocess.Popen([sys.executable, str(program), str(tmp_path / name)], env=environ)

    def records():
        return log.read_bytes().count(b"\n") if log.exists() else 0

    assert begin("whole").wait() == 0  # fills the cache
    random, reached = np.random.default_rng(0), []
    for _ in range(20):
        process, before, more = begin("killed"), records(), random.integers(0, 4)
        if more == 0:
            time.sleep(random.uniform(0.0, 5.0))
        while records() < before + more and process.poll() is None:
            time.sleep(0.01)
        time.sleep(random.uniform(0.0, 0.5))
        process.kill()
        assert process.wait() == -signal.SIGKILL
        reached.append(records())
    assert begin("killed").wait() == 0
    assert len(set(reached)) >= 8  # killed in the midst of it
    assert_same_bits(load(tmp_path / "killed" / "checkpoints"), load(tmp_path / "whole" / "checkpoints"))
    assert_same_bits(*(dict(np.load(tmp_path / name / "policy.npz")) for name in ("killed", "whole")))
    untimed = [
        [{key: value for key, value in one.items() if "second" not in key} for one in load(folder / "progress.jsonl")]
        for folder in (tmp_path / "killed", tmp_path / "whole")
    ]
    assert untimed[0] == untimed[1]


def test_no_training_state_holds_a_float64_leaf(whole):
    checkpoints = load(whole[1] / "checkpoints")
    leaves = jax.tree.leaves((checkpoints[str(ITERATIONS)]["training"], arms_in(checkpoints)))
    assert {np.asarray(leaf).dtype for leaf in leaves} <= {
        np.dtype(one) for one in (np.float32, np.int32, np.uint32, bool)
    }


def test_training_moved_the_policy_and_no_step_diverged(whole):
    policy, directory = whole
    seen = np.ones((3, policy.mean.shape[0]), np.float32)
    assert np.abs(deterministic_action(policy, seen)).max() > 0
    assert [record["invalid"] for record in load(directory / "progress.jsonl")[1:]] == [0] * ITERATIONS


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    directory = tmp_path_factory.mktemp("policy")
    return train_policy(ARM, ENGINE, POLICY, columns(), 0, directory), directory


def test_a_policy_is_trained_and_evaluated_on_targets_set_apart(trained):
    found, directory = trained
    assert found.left_out == {"uniform": 1, "near_home": 0}
    records = load(directory / "progress.jsonl")
    evaluated = [record for record in records if "evaluation/median_mm" in record]
    assert [record["iteration"] for record in evaluated] == [0, 2, 4]
    rates = load(directory / PHYSICS_RATES)
    assert [line["env_steps"] for line in rates] == [record["env_steps"] for record in evaluated]
    assert all(line["physics_steps_per_second"] > 0 for line in rates)
    for record in evaluated:
        medians = [record[f"evaluation/{name}_median_mm"] for name in ("uniform", "near_home")]
        assert record["evaluation/median_mm"] == pytest.approx(np.mean(medians))  # one target of each


@pytest.mark.parametrize("best", [0, 1, 2])
def test_the_policy_kept_is_the_best_of_those_evaluated(tmp_path, monkeypatch, best):
    """Not the last, nor the first: what the evaluation says is scripted."""
    evaluated, medians = [], iter(np.where(np.arange(3) == best, 1.0, 2.0))
    acting = policy_training.acting
    monkeypatch.setattr(policy_training, "acting", lambda policy: evaluated.append(policy) or acting(policy))
    monkeypatch.setattr(policy_training, "_medians", lambda *_: {"median_mm": float(next(medians))})
    kept = train_policy(ARM, ENGINE, POLICY, columns(), 0, tmp_path).policy
    assert len(evaluated) == 3
    assert [is_same(kept, policy) for policy in evaluated] == [number == best for number in range(3)]


def is_same(one, other) -> bool:
    return jax.tree.all(jax.tree.map(np.array_equal, one, other))


def test_a_finished_training_is_only_read_again(trained):
    found, directory = trained
    before = (directory / "progress.jsonl").read_text()
    again = train_policy(ARM, ENGINE, POLICY, columns(), 0, directory)
    assert_same_bits(again.policy, found.policy)
    assert (directory / "progress.jsonl").read_text() == before


def test_a_bank_that_is_too_small_is_one_line(tmp_path):
    config = dataclasses.replace(POLICY, num_evaluated=3)
    with pytest.raises(ConfigError, match=r"^policy\.num_evaluated: got 3, allowed: fewer than the 3 uniform targets"):
        train_policy(ARM, ENGINE, config, columns(), 0, tmp_path)
    assert not any(tmp_path.iterdir())
