import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from customary import customary_dagger, customary_ppo
from drifting_environment import NUM_ENVS, DriftingEnvironment

from qjrl.artifacts import load
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.dagger import deviation
from qjrl.learning.ppo.iteration import make_plan
from qjrl.learning.ppo.mesh import device_mesh
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.learning.ppo.programs import make_programs
from qjrl.learning.ppo.train import run_dagger, train
from qjrl.learning.ppo.trainer_state import policy_of

DAGGER = customary_dagger(rounds=2, steps=55, every=5, epochs=100, batch_size=128)
CONFIG = customary_ppo(
    num_steps=4 * 10 * NUM_ENVS,
    unroll_length=10,
    num_minibatches=2,
    actor_layers=(16,),
    critic_layers=(16,),
    checkpoint_every=2,
    initial_std=0.05,
    dagger=DAGGER,
    critic_warmup=1,
)
STEPS = 60 * NUM_ENVS  # 55, rounded up to whole rollouts
ITERATIONS = DAGGER.rounds + 4


def programs():
    """Of the training with `CONFIG`, and the plan."""
    plan = make_plan(DriftingEnvironment(), CONFIG, NUM_ENVS, ITERATIONS, device_mesh())
    return plan, make_programs(plan)


def rounds_of(env, numbers=(0, 1), **changes):
    """The policy and the records after these rounds, with what in the configuration matters on the host alone changed."""
    with jax.enable_x64(False):
        plan, compiled = programs()
        config = dataclasses.replace(CONFIG, **changes)
        trainer, records, made = compiled.begin(env, np.uint32(0)), [], []
        for number in numbers:
            trainer = dataclasses.replace(trainer, iteration=jnp.int32(number))
            trainer, record = run_dagger(dataclasses.replace(plan, config=config), compiled, env, trainer, made.append)
            records.append(record)
        assert sum(made) == int(trainer.env_steps) == len(numbers) * STEPS
        return policy_of(trainer, config), records


def test_the_actor_comes_to_do_what_the_expert_says():
    policy, records = rounds_of(DriftingEnvironment())
    values = np.linspace(-0.9, 0.9, 19, dtype=np.float32)
    seen = np.stack([values, np.ones_like(values)], axis=1)
    np.testing.assert_allclose(deterministic_action(policy, seen)[:, 0], -0.5 * values, atol=0.05)
    assert records[-1]["dagger_loss"] < 0.05


def test_after_the_last_round_the_actor_is_left_with_a_share_of_what_it_learnt():
    seen = np.stack([np.linspace(-0.9, 0.9, 5), np.ones(5)], axis=1)

    @functools.cache
    def before_tanh(number, share):
        policy, _ = rounds_of(DriftingEnvironment(), [number], dagger=dataclasses.replace(DAGGER, share=share))
        return np.arctanh(deterministic_action(policy, seen))

    last = DAGGER.rounds - 1
    assert np.abs(before_tanh(last, 1.0)).max() > 0.1
    np.testing.assert_allclose(before_tanh(last, 0.6), 0.6 * before_tanh(last, 1.0), rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(before_tanh(0, 0.6), before_tanh(0, 1.0))


@pytest.mark.parametrize("number", [0, 1])
def test_the_actions_of_a_rollout_are_the_actors_and_one_draw_of_noise_held(number):
    around = deviation(dataclasses.replace(DAGGER, exploration=0.2), number)
    with jax.enable_x64(False):
        _, compiled = programs()
        trainer = compiled.begin(DriftingEnvironment(), np.uint32(0))  # does nothing yet: all is noise
        _, (rollout, _) = compiled.collect(DriftingEnvironment(), trainer, np.float32(around))
    actions = np.asarray(rollout.action)
    np.testing.assert_array_equal(actions, np.broadcast_to(actions[:1], actions.shape))
    assert np.std(actions[0]) == pytest.approx([0.2, 0.02][number], rel=0.5)


def interrupt_at(iteration):
    def callback(record):
        if record["iteration"] == iteration:
            raise KeyboardInterrupt

    return callback


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("whole")
    return train(DriftingEnvironment(), CONFIG, NUM_ENVS, 0, directory), directory


@pytest.mark.parametrize("iteration", [0, 1, 2, 5])  # before, within and right after DAgger, and later
def test_a_training_interrupted_anywhere_ends_as_an_uninterrupted_one(whole, tmp_path, iteration):
    with pytest.raises(KeyboardInterrupt):
        train(DriftingEnvironment(), CONFIG, NUM_ENVS, 0, tmp_path, callbacks=[interrupt_at(iteration)])
    policy = train(DriftingEnvironment(), CONFIG, NUM_ENVS, 0, tmp_path)
    jax.tree.map(np.testing.assert_array_equal, policy, whole[0])
    jax.tree.map(np.testing.assert_array_equal, load(tmp_path / "checkpoints"), load(whole[1] / "checkpoints"))


def test_the_rounds_of_dagger_are_the_first_iterations_and_are_logged(whole):
    records = load(whole[1] / "progress.jsonl")
    assert [record["iteration"] for record in records] == list(range(ITERATIONS + 1))
    assert [record["env_steps"] for record in records[:3]] == [0, STEPS, 2 * STEPS]
    assert records[2]["dagger_loss"] < min(0.05, records[1]["dagger_loss"])
    assert records[2].keys() >= {"invalid", "invalid_fraction", "dagger_seconds", "dagger_steps_per_second"}
    assert ["dagger_loss" in record for record in records] == [False, True, True, False, False, False, False]
    assert records[-1]["env_steps"] == 2 * STEPS + CONFIG.num_steps


def test_without_an_expert_there_is_no_dagger(tmp_path):
    with pytest.raises(ValueError, match=r"^dagger\.rounds: got 2, allowed: 0, .*$"):
        train(DriftingEnvironment(has_expert=False), CONFIG, NUM_ENVS, 0, tmp_path)
    assert not list(tmp_path.iterdir())


def broken_envs(env):
    """Which of the envs are broken."""
    with jax.enable_x64(False):
        is_broken = programs()[1].begin(env, np.uint32(0)).envs.inner.is_broken
    assert 0 < is_broken.sum() < NUM_ENVS
    return np.flatnonzero(is_broken)


def test_rows_that_diverge_are_counted_and_not_imitated():
    env = DriftingEnvironment(broken_share=np.float32(0.1))
    share = len(broken_envs(env)) / NUM_ENVS
    _, records = rounds_of(env, max_invalid_fraction=0.3)
    assert [record["invalid_fraction"] for record in records] == pytest.approx([share, share])
    assert records[0]["invalid"] == share * STEPS
    assert records[1]["dagger_loss"] < 0.05  # 0.1 and more where a tenth of the rows say 1


@pytest.mark.parametrize(
    "period", [1, 5]
)  # of 5 steps one is stored, and that is another one than the one that diverges
def test_a_round_of_which_too_much_diverges_stops_with_what_is_known(tmp_path, period):
    env = DriftingEnvironment(broken_share=np.float32(0.4), period=np.int32(period))
    broken = broken_envs(env)
    share = f"{len(broken) / NUM_ENVS / period:.1%}".replace(".", r"\.")
    with pytest.raises(TrainingDiverged, match=rf"^iteration 1: {share} of the steps diverged .*diverged\.npz$"):
        train(env, CONFIG, NUM_ENVS, 0, tmp_path)
    found, steps = load(tmp_path / "diverged.npz"), np.arange(period - 1, CONFIG.unroll_length, period)
    np.testing.assert_array_equal(found["rollout_step"], np.repeat(steps, len(broken)))
    np.testing.assert_array_equal(found["env"], np.tile(broken, len(steps)))
    np.testing.assert_array_equal(found["inner/time"], found["rollout_step"])
    assert found["inner/is_broken"].all()
    np.testing.assert_array_equal(found["seen/state"][:, 0], found["inner/value"])
