import numpy as np
from probe_environments import NUM_ENVS, ProbeEnvironment, the_time

from qjrl.learning.ppo.evaluate import evaluate, roll_out
from qjrl.learning.ppo.policy import Policy


def constant_policy(action):
    """Whatever it sees, tanh^-1(action)."""
    layers = {
        "hidden_0": {"kernel": np.zeros((1, 2), np.float32), "bias": np.array([np.arctanh(action), 0], np.float32)}
    }
    mean, std = np.zeros(1, np.float32), np.ones(1, np.float32)
    return Policy(layers, mean, std, activation="swish", observation_clip=10.0)


def probe():
    """The reward is the time since the start plus the action: 0.5, 1.5, 2.5."""
    return ProbeEnvironment(the_time, lambda seen, action: seen + action, length=3, truncates=True)


def test_the_policy_is_scored_over_whole_episodes():
    metrics = evaluate(probe(), constant_policy(0.5), num_steps=6)
    assert metrics["episodes"] == 2 * NUM_ENVS
    assert metrics["return"] == 4.5
    assert metrics["reward"] == 1.5
    assert metrics["env_end/size"] == 2.5
    assert metrics["invalid"] == 0


def test_a_roll_out_starts_afresh():
    environment = probe()
    environment.reset()
    environment.step(np.zeros((NUM_ENVS, 1), np.float32))
    rewards = [transition.reward[0] for transition in roll_out(environment, constant_policy(0.5), 3)]
    assert rewards == [0.5, 1.5, 2.5]


def test_the_environment_is_left_as_it_was():
    environment = probe()
    environment.reset()
    environment.step(np.zeros((NUM_ENVS, 1), np.float32))
    evaluate(environment, constant_policy(0.5), num_steps=2)
    assert environment.step(np.zeros((NUM_ENVS, 1), np.float32)).reward[0] == 1
