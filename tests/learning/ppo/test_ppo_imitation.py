import dataclasses

import jax
import numpy as np
import pytest

from qjrl.artifacts import load
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.environment import Transition
from qjrl.learning.ppo.imitation import ImitationConfig, imitate
from qjrl.learning.ppo.iteration import compile_functions
from qjrl.learning.ppo.normaliser import initial_normaliser
from qjrl.learning.ppo.policy import deterministic_action
from qjrl.learning.ppo.train import train
from qjrl.learning.ppo.training_state import initial_state, policy_of

NUM_ENVS = 32
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


class DriftingEnvironment:
    """A number drifts about and is pushed by the action; the advice is to push it back by half of what it is."""

    num_envs, action_size, gives_advice = NUM_ENVS, 1, True

    def __init__(self):
        self.observation_sizes = {"state": 2, "privileged_state": 2}
        self.key, self.value = np.zeros(1, np.int64), np.zeros(NUM_ENVS, np.float32)

    def reset(self):
        self.value = np.linspace(-1, 1, NUM_ENVS, dtype=np.float32)
        return self._observation()

    def step(self, actions):
        self.key += 1
        noise = np.random.default_rng(int(self.key[0])).uniform(-0.3, 0.3, NUM_ENVS)
        self.value = np.clip(self.value + noise + 0.5 * np.asarray(actions)[:, 0], -1, 1).astype(np.float32)
        observation, never = self._observation(), np.zeros(NUM_ENVS, bool)
        return Transition(observation, -np.abs(self.value), never, never, observation, ~never)

    def get_state(self):
        return {"key": self.key.copy(), "value": self.value.copy()}

    def set_state(self, state):
        self.key, self.value = np.array(state["key"]), np.array(state["value"])

    def _observation(self):
        constant = np.ones(NUM_ENVS, np.float32)
        return {
            "state": np.stack([self.value, constant], axis=1),
            "privileged_state": np.stack([constant, -0.5 * self.value], axis=1),
        }


def untrained(environment):
    compiled = compile_functions(CONFIG, environment)
    return policy_of(initial_state(compiled.initialise, CONFIG, environment, 0), CONFIG)


def test_the_actor_comes_to_do_what_is_advised():
    environment = DriftingEnvironment()
    observation, normaliser, loss = environment.reset(), initial_normaliser(environment.observation_sizes), np.nan
    policy, made = untrained(environment), []
    for number in range(IMITATION.rounds):
        found = imitate(environment, IMITATION, number, policy, normaliser, observation, 0, made.append)
        policy, normaliser, observation, loss = found.policy, found.normaliser, found.observation, found.loss
    assert sum(made) == NUM_ENVS * int(environment.key[0]) == NUM_ENVS * IMITATION.rounds * IMITATION.steps
    values = np.linspace(-0.9, 0.9, 19, dtype=np.float32)
    seen = np.stack([values, np.ones_like(values)], axis=1)
    np.testing.assert_allclose(deterministic_action(policy, seen)[:, 0], -0.5 * values, atol=0.05)
    assert loss < 0.05


def test_after_the_last_round_the_actor_is_left_with_a_share_of_what_it_learnt():
    seen = np.stack([np.linspace(-0.9, 0.9, 5), np.ones(5)], axis=1)

    def before_tanh(number, share):
        environment, config = DriftingEnvironment(), dataclasses.replace(IMITATION, share=share)
        observation, normaliser = environment.reset(), initial_normaliser(environment.observation_sizes)
        actor = untrained(environment)
        found = imitate(environment, config, number, actor, normaliser, observation, 0, lambda steps: None)
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
