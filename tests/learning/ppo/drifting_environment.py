"""A toy environment with advice, of which several processes may have a part each."""

import numpy as np

from qjrl.learning.ppo.environment import Transition

NUM_ENVS = 32


class DriftingEnvironment:
    """A number drifts about and is pushed by the action; the advice is to push it back by half of what it is.

    `own`: which of all copies these are.
    """

    action_size, gives_advice = 1, True

    def __init__(self, own=slice(0, NUM_ENVS)):
        self.own, self.num_envs = own, own.stop - own.start
        self.observation_sizes = {"state": 2, "privileged_state": 2}
        self.key, self.value = np.zeros(self.num_envs, np.int64), np.zeros(self.num_envs, np.float32)

    def reset(self):
        self.value = np.linspace(-1, 1, NUM_ENVS, dtype=np.float32)[self.own]
        return self._observation()

    def step(self, actions):
        self.key += 1
        noise = np.random.default_rng(int(self.key[0])).uniform(-0.3, 0.3, NUM_ENVS)[self.own]
        self.value = np.clip(self.value + noise + 0.5 * np.asarray(actions)[:, 0], -1, 1).astype(np.float32)
        observation, never = self._observation(), np.zeros(self.num_envs, bool)
        return Transition(observation, -np.abs(self.value), never, never, observation, ~never)

    def get_state(self):
        return {"key": self.key.copy(), "value": self.value.copy()}

    def set_state(self, state):
        self.key, self.value = np.array(state["key"]), np.array(state["value"])

    def _observation(self):
        constant = np.ones(self.num_envs, np.float32)
        return {
            "state": np.stack([self.value, constant], axis=1),
            "privileged_state": np.stack([constant, -0.5 * self.value], axis=1),
        }
