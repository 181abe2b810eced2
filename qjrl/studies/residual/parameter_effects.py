"""The randomised parameters one at a time: which of them makes a controller err."""

import dataclasses

from qjrl.control.randomisation import RandomisationConfig

NOMINAL = RandomisationConfig(
    strand_damping_scale=(1.0, 1.0),
    strand_friction=(0.0, 0.0),
    armature_scale=(1.0, 1.0),
    gain_scale=(1.0, 1.0),
    largest_tilt_deg=0.0,
    encoder_noise_deg=0.0,
)
"""The arm of the model, with encoders without noise."""


def one_at_a_time(config: RandomisationConfig) -> dict[str, RandomisationConfig]:
    """ "nothing", then every parameter that `config` varies, alone, by its name, then "all"."""
    varied = [
        field.name
        for field in dataclasses.fields(config)
        if getattr(config, field.name) != getattr(NOMINAL, field.name)
    ]
    alone = {name: dataclasses.replace(NOMINAL, **{name: getattr(config, name)}) for name in varied}
    return {"nothing": NOMINAL, **alone, "all": config}
