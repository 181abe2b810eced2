import dataclasses

import pytest

from qjrl.config import as_mapping
from qjrl.control.policy_training import PolicyConfig
from qjrl.control.randomisation import RandomisationConfig
from qjrl.learning.ppo.config import PPOConfig
from qjrl.learning.ppo.dagger import DaggerConfig
from qjrl.studies.residual.ablations import ABLATIONS, USUAL_RATES, ablations
from qjrl.studies.residual.parameter_effects import NOMINAL, one_at_a_time

CONFIG = PolicyConfig(ppo=PPOConfig(num_steps=1000, learning_rate=1e-5, target_kl=0.01, dagger=DaggerConfig(rounds=8)))


def differences(one, other, path=""):
    """Dotted names of what differs between two configurations."""
    if not isinstance(one, dict):
        return [path[1:]] if one != other else []
    return [name for key in one for name in differences(one[key], other[key], f"{path}.{key}")]


def test_every_ablation_is_shortened_and_changes_what_its_name_says():
    made = ablations(CONFIG, 0.25)
    assert tuple(made) == ABLATIONS
    reference = as_mapping(made["as it is"])
    assert differences(as_mapping(CONFIG), reference) == ["ppo.num_steps", "ppo.dagger.rounds"]
    assert made["as it is"].ppo.num_steps == 250 and made["as it is"].ppo.dagger.rounds == 2
    changed = {name: set(differences(reference, as_mapping(config))) for name, config in made.items()}
    usual = {f"ppo.{name}" for name in USUAL_RATES}
    residual, randomised = "environment.residual", "environment.randomisation"
    assert changed == {
        "as it is": set(),
        "no DAgger": {"ppo.dagger.rounds", *usual},
        "no DAgger, random start": {"ppo.dagger.rounds", "ppo.starts_at_zero", *usual},
        "20 mm a step": {f"{residual}.bound", f"{residual}.rate", f"{residual}.lag"},
        "no sensor memory": {"environment.remembers"},
        "no prior": {f"environment.estimate.{name}" for name in ("gain", "tilt_deg", "friction")},
        "noise a fifth": {f"{randomised}.encoder_noise_deg", "environment.estimate.encoder_noise_deg"},
        "no randomisation": {
            f"{randomised}.{name}"
            for name in ("strand_damping_scale", "strand_friction", "armature_scale", "gain_scale", "largest_tilt_deg")
        },
    }


@pytest.mark.parametrize("extra", [{}, {"payload": (0.0, 0.05)}])
def test_one_parameter_at_a_time_is_what_its_name_says(extra):
    config = RandomisationConfig(**extra)
    alone = one_at_a_time(config)
    assert alone["nothing"] == NOMINAL and alone["all"] == config
    names = [name for name in alone if name not in ("nothing", "all")]
    assert len(names) == 6 + len(extra)
    for name in names:
        assert alone[name] == dataclasses.replace(NOMINAL, **{name: getattr(config, name)}) != NOMINAL
