import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.learning.ppo.advantages import advantages_and_returns


@dataclasses.dataclass
class Steps:
    """Three steps of one environment, reward 1 each."""

    terminated: list = dataclasses.field(default_factory=lambda: [0, 0, 0])
    truncated: list = dataclasses.field(default_factory=lambda: [0, 0, 0])
    valid: list = dataclasses.field(default_factory=lambda: [1, 1, 1])

    def __post_init__(self):
        for field in dataclasses.fields(self):
            setattr(self, field.name, jnp.asarray(getattr(self, field.name), bool)[:, None])
        self.reward = jnp.ones((3, 1), jnp.float32)


VALUES = jnp.array([[2.0], [3.0], [4.0]], jnp.float32)
LAST_VALUE = jnp.array([5.0], jnp.float32)
FINAL_VALUES = jnp.array([[0.0], [10.0], [0.0]], jnp.float32)


def estimate(steps):
    """Discount 0.5, lambda 0.5."""
    advantages, returns = advantages_and_returns(steps, VALUES, LAST_VALUE, FINAL_VALUES, 0.5, 0.5)
    assert returns == pytest.approx(np.asarray(advantages + VALUES))
    assert advantages.dtype == returns.dtype == jnp.float32
    return np.asarray(advantages)[:, 0].tolist()


def test_an_episode_that_goes_on():
    # delta = 1 + 0.5 V' - V: 1 + 1.5 - 2 = 0.5; 1 + 2 - 3 = 0; 1 + 2.5 - 4 = -0.5
    # A2 = -0.5; A1 = 0 + 0.25 * -0.5 = -0.125; A0 = 0.5 + 0.25 * -0.125 = 0.46875
    assert estimate(Steps()) == [0.46875, -0.125, -0.5]


def test_nothing_comes_after_termination():
    # delta1 = 1 + 0 - 3 = -2 and the sum stops there; A0 = 0.5 + 0.25 * -2 = 0
    assert estimate(Steps(terminated=[0, 1, 0])) == [0.0, -2.0, -0.5]


def test_the_final_observation_stands_for_what_a_time_limit_cut_off():
    # delta1 = 1 + 0.5 * 10 - 3 = 3; A0 = 0.5 + 0.25 * 3 = 1.25; step 2 belongs to the next episode
    assert estimate(Steps(truncated=[0, 1, 0])) == [1.25, 3.0, -0.5]


def test_an_invalid_step_has_no_advantage_and_passes_none_on():
    # A1 = 0; A0 = 0.5: it sees no further than V of the state in which the invalid step began
    assert estimate(Steps(valid=[1, 0, 1])) == [0.5, 0.0, -0.5]


def test_an_invalid_end_of_an_episode_does_not_reach_back():
    assert estimate(Steps(valid=[1, 0, 1], terminated=[0, 1, 0])) == [0.5, 0.0, -0.5]
