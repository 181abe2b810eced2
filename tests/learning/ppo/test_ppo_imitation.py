import dataclasses

import jax
import numpy as np
import pytest
from drifting_environment import NUM_ENVS, DriftingEnvironment

from qjrl.artifacts import load
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.imitation import Imitated, ImitationConfig, imitate
from qjrl.learning.ppo.iteration import compile_functions
from qjrl.learning.ppo.normaliser import initial_normaliser, update_normaliser
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.learning.ppo.train import train
from qjrl.learning.ppo.training_state import initial_state, policy_of

TAKE_IN = jax.jit(update_normaliser)
IMITATION = ImitationConfig(rounds=2, steps=60, every=3, epochs=60, batch_size=128)
CONFIG = PPOConfig(
    num_steps=4 * 5 * NUM_ENVS,
    unroll_length=5,
    num_minibatches=2,
    actor_layers=(16,),
    critic_layers=(16,),
    checkpoint_every=2,
    initial_std=0.05,
    imitation=IMITATION,
    critic_warmup=1,
)


def untrained(environment):
    compiled = compile_functions(CONFIG, environment)
    return policy_of(initial_state(compiled.initialise, CONFIG, environment, 0), CONFIG)


def begun(environment):
    return Imitated(untrained(environment), initial_normaliser(environment.observation_sizes), environment.reset())


def test_the_actor_comes_to_do_what_is_advised():
    environment, made = DriftingEnvironment(), []
    found = begun(environment)
    for number in range(IMITATION.rounds):
        found = imitate(environment, IMITATION, number, found, TAKE_IN, 0, made.append)
    assert sum(made) == NUM_ENVS * int(environment.key[0]) == NUM_ENVS * IMITATION.rounds * IMITATION.steps
    values = np.linspace(-0.9, 0.9, 19, dtype=np.float32)
    seen = np.stack([values, np.ones_like(values)], axis=1)
    np.testing.assert_allclose(deterministic_action(found.policy, seen)[:, 0], -0.5 * values, atol=0.05)
    assert found.loss < 0.05


def test_after_the_last_round_the_actor_is_left_with_a_share_of_what_it_learnt():
    seen = np.stack([np.linspace(-0.9, 0.9, 5), np.ones(5)], axis=1)

    def before_tanh(number, share):
        environment, config = DriftingEnvironment(), dataclasses.replace(IMITATION, share=share)
        found = imitate(environment, config, number, begun(environment), TAKE_IN, 0, lambda steps: None)
        return np.arctanh(deterministic_action(found.policy, seen))

    last = IMITATION.rounds - 1
    assert np.abs(before_tanh(last, 1.0)).max() > 0.1
    np.testing.assert_allclose(before_tanh(last, 0.6), 0.6 * before_tanh(last, 1.0), rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(before_tanh(0, 0.6), before_tanh(0, 1.0))


def interrupt_at(iteration):
    def callback(record):
        if record["iteration"] == iteration:
            raise KeyboardInterrupt

    return callback


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("whole")
    return train(DriftingEnvironment(), CONFIG, 0, directory), directory


@pytest.mark.parametrize("iteration", [0, 1, 2, 5])  # before, within and right after the imitation, and later
def test_a_training_interrupted_anywhere_ends_as_an_uninterrupted_one(whole, tmp_path, iteration):
    with pytest.raises(KeyboardInterrupt):
        train(DriftingEnvironment(), CONFIG, 0, tmp_path, callbacks=[interrupt_at(iteration)])
    policy = train(DriftingEnvironment(), CONFIG, 0, tmp_path)
    jax.tree.map(np.testing.assert_array_equal, policy, whole[0])


def test_the_rounds_of_imitation_are_the_first_iterations_and_are_logged(whole):
    records = load(whole[1] / "progress.jsonl")
    assert [record["iteration"] for record in records] == [0, 1, 2, 3, 4, 5, 6]
    assert [record["env_steps"] for record in records[:3]] == [0, 60 * NUM_ENVS, 2 * 60 * NUM_ENVS]
    assert records[2]["imitation_loss"] < min(0.05, records[1]["imitation_loss"])
    assert records[-1]["env_steps"] == (2 * 60 + 4 * 5) * NUM_ENVS


def test_without_advice_there_is_no_imitation(tmp_path):
    environment = DriftingEnvironment()
    environment.gives_advice = False
    with pytest.raises(ValueError, match=r"imitation\.rounds: got 2, allowed: 0"):
        train(environment, CONFIG, 0, tmp_path)


class BreakingEnvironment(DriftingEnvironment):
    """Every tenth copy diverges at every step, and its advice is nonsense."""

    broken = np.arange(NUM_ENVS) % 10 == 0

    def step(self, actions):
        ids = np.flatnonzero(self.broken)
        return dataclasses.replace(super().step(actions), valid=~self.broken, diverged={"copy": ids})

    def _observation(self):
        found = super()._observation()
        found["privileged_state"][self.broken, 1] = 1.0
        return found


def test_copies_that_diverge_are_counted_and_not_imitated(tmp_path):
    config = dataclasses.replace(CONFIG, max_invalid_fraction=0.2)
    train(BreakingEnvironment(), config, 0, tmp_path)
    records = load(tmp_path / "progress.jsonl")
    share = BreakingEnvironment.broken.mean()
    assert [record["invalid_fraction"] for record in records[1:3]] == pytest.approx([share, share])
    assert records[1]["invalid"] == BreakingEnvironment.broken.sum() * IMITATION.steps
    assert records[2]["imitation_loss"] < 0.05  # 0.1 and more where a tenth of the rows advise 1


def test_an_imitation_of_which_too_much_diverges_stops_with_what_is_known(tmp_path):
    with pytest.raises(TrainingDiverged, match=r"^iteration 1: 12\.5% of the steps diverged .*diverged\.npz$"):
        train(BreakingEnvironment(), CONFIG, 0, tmp_path)
    found = load(tmp_path / "diverged.npz")
    assert set(found["copy"]) == set(np.flatnonzero(BreakingEnvironment.broken))
    assert set(found["rollout_step"]) == set(range(20))
