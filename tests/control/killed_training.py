"""Trains a small policy on the real arm into a folder: python killed_training.py FOLDER. Run, killed and run again by
test_policy_training.py."""

import dataclasses
import sys
from pathlib import Path

import jax
from customary import customary_dagger
from test_policy_training import POLICY, columns
from worlds import ARM, ENGINE

from qjrl.control.policy_training import train_policy

PPO = dataclasses.replace(
    POLICY.ppo,
    num_steps=120 * POLICY.num_envs * POLICY.ppo.unroll_length,
    dagger=customary_dagger(rounds=4, steps=40),
)

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    config = dataclasses.replace(POLICY, ppo=PPO)
    train_policy(ARM, ENGINE, config, columns(), 0, Path(sys.argv[1]))
