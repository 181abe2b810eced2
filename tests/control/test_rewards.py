import dataclasses
import math

import jax.numpy as jnp
import pytest

from qjrl.control.rewards import RewardConfig, reward

CONFIG = RewardConfig(
    position_scale=0.002, orientation_scale=0.01, orientation_weight=0.5, distance_weight=0.05, action_weight=0.02
)


def reward_of(position, orientation, action=(0.0, 0.0), has_arrived=True):
    return float(
        reward(CONFIG, jnp.asarray(position), jnp.asarray(orientation), jnp.array(action), jnp.asarray(has_arrived))
    )


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((0.0, 0.0), 1.5),  # on the target
        ((0.002, 0.01), 1.5 / math.e - 0.05),  # one scale away in both
        ((0.004, 0.0), math.exp(-2) + 0.5 - 0.1),
        ((0.0, 0.0, (1.0, -1.0)), 1.5 - 0.02),
        ((0.0, 0.0, (0.5, 0.0)), 1.5 - 0.02 * 0.125),
        ((0.4, 3.0), -1.0),  # 200 scales away: the slope ends at 20
        ((0.001, 0.02, (0.0, 0.0), False), 0.0),  # the ramp is under way
        ((0.001, 0.02, (1.0, 1.0), False), -0.02),  # but moving about costs
    ],
)
def test_reward_by_hand_numbers(arguments, expected):
    assert reward_of(*arguments) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("position", "orientation", "bonus"), [(0.004, 0.01, 2.0), (0.006, 0.01, 0.0), (0.004, 0.03, 0.0)]
)
def test_a_success_is_near_in_both(position, orientation, bonus):
    success = dataclasses.replace(CONFIG, bonus=2.0, bonus_position=0.005, bonus_orientation=0.02)
    earned = [reward(one, *map(jnp.asarray, (position, orientation, [0.0], True))) for one in (CONFIG, success)]
    assert float(earned[1] - earned[0]) == pytest.approx(bonus, abs=1e-6)


def test_nearer_is_better_everywhere_within_reach():
    distances = [0.0, 1e-4, 1e-3, 5e-3, 0.02, 0.039]
    rewards = [reward_of(distance, 0.1) for distance in distances]
    assert rewards == sorted(rewards, reverse=True) and len(set(rewards)) == len(rewards)
