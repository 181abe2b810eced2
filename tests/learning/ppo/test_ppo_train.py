import dataclasses

import jax
import numpy as np
import pytest
from probe_environments import NUM_ENVS, ProbeEnvironment, a_sign

from qjrl.artifacts import ArtifactError, load
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.evaluate import evaluate
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.learning.ppo.train import train

ITERATIONS = 5
CONFIG = PPOConfig(
    num_steps=ITERATIONS * 4 * NUM_ENVS,
    unroll_length=4,
    num_epochs=2,
    num_minibatches=2,
    actor_layers=(8,),
    critic_layers=(8,),
    checkpoint_every=2,
)
TIMES = {"steps_per_second", "environment_seconds", "act_seconds", "learning_seconds"}


def probe():
    """Episodes of three steps cut off by the time limit, so that none fits a rollout of four."""
    return ProbeEnvironment(a_sign, lambda seen, action: seen - np.square(action - 0.5 * seen), 3, truncates=True)


@pytest.fixture(autouse=True, scope="module")
def _every_key_is_used_once():
    with jax.debug_key_reuse(True):
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted training and its directory."""
    directory = tmp_path_factory.mktemp("whole")
    return train(probe(), CONFIG, 0, directory), directory


def progress_without_times(directory):
    return [{k: v for k, v in record.items() if k not in TIMES} for record in load(directory / "progress.jsonl")]


def interrupt_at(iteration):
    def callback(record):
        if record["iteration"] == iteration:
            raise KeyboardInterrupt

    return callback


def assert_same_bits(one, other):
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(np.asarray(a), np.asarray(b)), one, other)


@pytest.mark.parametrize("iteration", [1, 3, 4])  # on the way to a checkpoint, and in one
def test_a_resumed_training_equals_an_uninterrupted_one_bit_for_bit(whole, tmp_path, iteration):
    with pytest.raises(KeyboardInterrupt):
        train(probe(), CONFIG, 0, tmp_path, callbacks=[interrupt_at(iteration)])
    policy = train(probe(), CONFIG, 0, tmp_path)
    expected, directory = whole
    assert_same_bits(policy, expected)
    assert_same_bits(load(tmp_path / "checkpoints"), load(directory / "checkpoints"))
    assert progress_without_times(tmp_path) == progress_without_times(directory)


def test_a_finished_training_is_only_read_again(whole):
    policy, directory = whole
    assert_same_bits(train(probe(), CONFIG, 0, directory, callbacks=[interrupt_at(1)]), policy)


def test_another_seed_is_another_training(whole):
    with pytest.raises(ArtifactError, match="another configuration"):
        train(probe(), CONFIG, 1, whole[1])


def test_no_training_state_holds_a_float64_leaf(whole):
    training = load(whole[1] / "checkpoints")[str(ITERATIONS)]["training"]
    dtypes = {leaf.dtype for leaf in jax.tree.leaves(training)}
    assert dtypes == {np.dtype(np.float32), np.dtype(np.int32), np.dtype(np.uint32)}


def test_the_log_tells_what_happened(whole):
    records = load(whole[1] / "progress.jsonl")
    assert [record["iteration"] for record in records] == [0, 1, 2, 3, 4, 5]
    assert records[-1]["env_steps"] == CONFIG.num_steps
    assert [record["episodes"] // NUM_ENVS for record in records[1:]] == [1, 1, 2, 1, 1]  # ends at 3, 6, 9, 12, 15, 18
    assert records[-1].keys() >= TIMES


def test_the_policy_with_the_smallest_metric_is_kept(tmp_path):
    errors = iter([0.9, 0.2, 0.7, 0.5])  # of the iterations 0, 2, 4, 5
    seen = []

    def judge(policy):
        seen.append(policy)
        return {"error": next(errors)}

    kept = train(probe(), CONFIG, 0, tmp_path, evaluate=judge, minimise="error")
    assert_same_bits(kept, seen[1])
    lines = [(record["iteration"], record.get("evaluation/error")) for record in load(tmp_path / "progress.jsonl")]
    assert lines == [(0, 0.9), (1, None), (2, 0.2), (3, None), (4, 0.7), (5, 0.5)]


def test_the_policy_judged_before_training_does_exactly_nothing(tmp_path):
    def judge(policy):
        rows = np.array([[-1], [1]], np.float32)
        assert np.array_equal(np.asarray(deterministic_action(policy, rows)), np.zeros((2, 1)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(probe(), CONFIG, 0, tmp_path, evaluate=judge, minimise="error")


def test_judging_by_the_environment_of_the_training_leaves_no_trace(whole, tmp_path):
    environment = probe()
    policy = train(environment, CONFIG, 0, tmp_path, evaluate=lambda policy: evaluate(environment, policy, 5))
    assert_same_bits(policy, whole[0])


class Diverging(ProbeEnvironment):
    """Half of the copies diverge at every step."""

    def step(self, actions):
        return dataclasses.replace(super().step(actions), valid=np.arange(NUM_ENVS) % 2 == 0)


def test_too_many_diverged_steps_stop_the_training(tmp_path):
    environment = Diverging(a_sign, lambda seen, action: seen)
    with pytest.raises(TrainingDiverged, match=r"iteration 1: 50.0% of the steps .* allowed: 5.0%"):
        train(environment, CONFIG, 0, tmp_path)


class Telling(Diverging):
    """... and say what they were doing."""

    def step(self, actions):
        ids = np.flatnonzero(np.arange(NUM_ENVS) % 2)
        return dataclasses.replace(super().step(actions), diverged={"copy": ids, "commands": np.asarray(actions)[ids]})


def test_what_diverged_copies_were_doing_is_written_where_the_message_says(tmp_path):
    with pytest.raises(
        TrainingDiverged, match=rf"allowed: 5.0% .*states, commands and parameters: {tmp_path}/diverged"
    ):
        train(Telling(a_sign, lambda seen, action: seen), CONFIG, 0, tmp_path)
    found = load(tmp_path / "diverged.npz")
    per_step, steps = NUM_ENVS // 2, CONFIG.unroll_length
    assert found["rollout_step"].tolist() == np.repeat(np.arange(steps), per_step).tolist()
    np.testing.assert_array_equal(found["copy"], np.tile(np.arange(1, NUM_ENVS, 2), steps))
    assert found["commands"].shape == (per_step * steps, 1) and np.isfinite(found["commands"]).all()


def test_rewards_that_are_not_finite_count_as_diverged(tmp_path):
    environment = ProbeEnvironment(a_sign, lambda seen, action: np.where(seen > 0, np.float32(np.nan), seen))
    with pytest.raises(TrainingDiverged, match="iteration 1"):
        train(environment, CONFIG, 0, tmp_path)


def test_more_minibatches_than_steps_are_refused(tmp_path):
    config = dataclasses.replace(CONFIG, unroll_length=1, num_minibatches=100)
    with pytest.raises(ValueError, match="num_minibatches: got 100, allowed: at most 64"):
        train(probe(), config, 0, tmp_path)
