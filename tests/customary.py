"""PPO that begins with an untrained actor, for tests of the learner: the package's defaults refine one that DAgger has fitted."""

import dataclasses
from typing import Any

from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.dagger import DaggerConfig
from qjrl.studies.residual.ablations import USUAL_RATES


def customary_ppo(**changes: Any) -> PPOConfig:
    """The customary values, and those given in place of some."""
    usual = PPOConfig(
        dagger=customary_dagger(rounds=0), critic_warmup=0, entropy_cost=1e-3, initial_std=0.3, **USUAL_RATES
    )
    return dataclasses.replace(usual, **changes)


def customary_dagger(**changes: Any) -> DaggerConfig:
    """Rounds whose fit the actor keeps whole."""
    return dataclasses.replace(DaggerConfig(steps=1000, epochs=4, share=1.0), **changes)
