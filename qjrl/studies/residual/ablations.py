"""The training of the residual policy with one thing changed at a time, each for a share of the steps."""

import dataclasses
from collections.abc import Callable
from typing import Any

from qjrl.control.policy_training import PolicyConfig
from qjrl.studies.residual.parameter_effects import NOMINAL

_Change = Callable[[PolicyConfig], PolicyConfig]
USUAL_RATES: dict[str, Any] = {
    "learning_rate": 1e-3,
    "min_learning_rate": 1e-5,
    "max_learning_rate": 3e-3,
    "target_kl": 0.02,
}
"""Of PPO that begins with an untrained actor: rsl_rl's, but for a lower ceiling (its own is 1e-2)."""


def ablations(config: PolicyConfig, share: float) -> dict[str, PolicyConfig]:
    """Name -> configuration; "as it is" first. All have `share` of the rounds of DAgger and of the steps of PPO."""
    dagger = dataclasses.replace(config.ppo.dagger, rounds=round(share * config.ppo.dagger.rounds))
    shortened = _with_ppo(config, num_steps=max(1, round(share * config.ppo.num_steps)), dagger=dagger)
    return {name: change(shortened) for name, change in _CHANGES.items()}


def _with_ppo(config: PolicyConfig, **changes: Any) -> PolicyConfig:
    return dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, **changes))


def _with_environment(config: PolicyConfig, **changes: Any) -> PolicyConfig:
    return dataclasses.replace(config, environment=dataclasses.replace(config.environment, **changes))


def _without_dagger(config: PolicyConfig) -> PolicyConfig:
    """With the customary rates of learning: those of a policy that is refined alone are too small for one that begins."""
    return _with_ppo(config, dagger=dataclasses.replace(config.ppo.dagger, rounds=0), **USUAL_RATES)


def _from_noise(config: PolicyConfig) -> PolicyConfig:
    return _with_ppo(_without_dagger(config), starts_at_zero=False)


def _without_rate(config: PolicyConfig) -> PolicyConfig:
    """The paper's: up to 20 mm at once (section 4)."""
    bound = 0.02
    rate = bound / config.environment.control_period
    residual = dataclasses.replace(config.environment.residual, bound=bound, rate=rate, lag=0.0)
    return _with_environment(config, residual=residual)


def _with_nominal_noise(config: PolicyConfig) -> PolicyConfig:
    randomisation = config.environment.randomisation
    less = dataclasses.replace(randomisation, encoder_noise_deg=randomisation.encoder_noise_deg / 5.0)
    known = dataclasses.replace(config.environment.estimate, encoder_noise_deg=less.encoder_noise_deg)
    return _with_environment(config, randomisation=less, estimate=known)


def _without_prior(config: PolicyConfig) -> PolicyConfig:
    """The estimate is the readings' mean when next to nothing is believed before."""
    known = config.environment.estimate
    vague = {name: 100.0 * getattr(known, name) for name in ("gain", "tilt_deg", "friction")}
    return _with_environment(config, estimate=dataclasses.replace(known, **vague))


def _without_randomisation(config: PolicyConfig) -> PolicyConfig:
    noise = config.environment.randomisation.encoder_noise_deg
    return _with_environment(config, randomisation=dataclasses.replace(NOMINAL, encoder_noise_deg=noise))


_CHANGES: dict[str, _Change] = {
    "as it is": lambda config: config,
    "no DAgger": _without_dagger,
    "no DAgger, random start": _from_noise,
    "20 mm a step": _without_rate,
    "no sensor memory": lambda config: _with_environment(config, remembers=False),
    "no prior": _without_prior,
    "noise a fifth": _with_nominal_noise,
    "no randomisation": _without_randomisation,
}
ABLATIONS = tuple(_CHANGES)
