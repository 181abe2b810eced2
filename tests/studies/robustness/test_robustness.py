import dataclasses

from qjrl.control.episode import EnvironmentConfig
from qjrl.control.randomisation import RandomisationConfig
from qjrl.studies.robustness.measure import UNDISTURBED, RobustnessConfig, disturbances

CHANGES = {
    "gains +30 %": {"gain_scale": (1.3 * 0.8, 1.3 * 1.25)},
    "gains −30 %": {"gain_scale": (0.7 * 0.8, 0.7 * 1.25)},
    "friction ×3": {"strand_friction": (0.0, 9.0)},
    "10° of tilt": {"least_tilt_deg": 10.0, "largest_tilt_deg": 10.0},
    "50 g payload": {"payload": (0.05, 0.05)},
    "one dead encoder": {"dead_encoder_share": 1.0},
    "40 ms delay": {"delay": (2, 2)},
    "backlash ±0.1 mm": {"backlash": (1e-4, 1e-4)},
}


def test_each_disturbance_changes_one_thing_of_the_environment_trained_in():
    found = disturbances(RobustnessConfig(), EnvironmentConfig())
    assert found.pop(UNDISTURBED) == EnvironmentConfig()
    assert found.keys() == CHANGES.keys()
    for name, change in CHANGES.items():
        randomisation = dataclasses.replace(RandomisationConfig(), **change)
        assert found[name] == dataclasses.replace(EnvironmentConfig(), randomisation=randomisation)
