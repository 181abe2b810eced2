"""What a controller was not made for: named disturbances, each a change of the environment that it is evaluated in."""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np

from qjrl.config import Range, configuration
from qjrl.control.bases import Base, command_column
from qjrl.control.comparison import compare_controllers
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.evaluation import Evaluation, first_in_time
from qjrl.control.policy_training import PolicyConfig
from qjrl.control.randomisation import Interval, RandomisationConfig
from qjrl.learning.ppo.policy import Policy
from qjrl.robot.verbs import Robot
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.settle_problem import SettleConfig

UNDISTURBED = "as trained"


@configuration
class RobustnessConfig:
    """Group `robustness`: how large the disturbances are, and who meets them. All but one thing is drawn as in training.
    All values ours."""

    num_targets: Annotated[int, Range(1, 100_000)] = 150
    """Held-out targets of each set."""
    bases: tuple[Base, ...] = ("learned", "integral", "dither_integral")
    """Controllers beside the policy and its own base."""
    engine: Literal["simulation", "training"] = "simulation"
    """What they are evaluated in: that of group `simulation`, or that of group `engine`, in which policies train."""
    gain_change: Annotated[float, Range(above=0.0, below=1.0)] = 0.3
    """All gains drawn are larger, and in another row smaller, by this share."""
    friction_factor: Annotated[float, Range(above=0.0)] = 3.0
    """Times the dry friction drawn."""
    tilt_deg: Annotated[float, Range(0.0, 90.0)] = 10.0
    """Of the base, in any direction [deg]."""
    payload: Annotated[float, Range(above=0.0)] = 0.05
    """At the tip [kg]."""
    delay: Annotated[int, Range(1, 100)] = 2
    """Control periods that a command takes to the motors."""
    backlash: Annotated[float, Range(above=0.0)] = 0.0001
    """Half the width of the dead band between motors and cables [m]."""


def disturbances(config: RobustnessConfig, environment: EnvironmentConfig) -> dict[str, EnvironmentConfig]:
    """Name -> environment, the undisturbed one first; tilt, payload, delay and backlash take the place of those trained with."""
    drawn = environment.randomisation
    percent, tilt, late = 100.0 * config.gain_change, config.tilt_deg, config.delay * environment.control_period
    changes: dict[str, dict[str, Any]] = {
        UNDISTURBED: {},
        f"gains +{percent:g} %": {"gain_scale": _times(1.0 + config.gain_change, drawn.gain_scale)},
        f"gains −{percent:g} %": {"gain_scale": _times(1.0 - config.gain_change, drawn.gain_scale)},
        f"friction ×{config.friction_factor:g}": {
            "strand_friction": _times(config.friction_factor, drawn.strand_friction)
        },
        f"{tilt:g}° of tilt": {"least_tilt_deg": tilt, "largest_tilt_deg": tilt},
        f"{1e3 * config.payload:g} g payload": {"payload": (config.payload, config.payload)},
        "one dead encoder": {"dead_encoder_share": 1.0},
        f"{1e3 * late:g} ms delay": {"delay": (config.delay, config.delay)},
        f"backlash ±{1e3 * config.backlash:g} mm": {"backlash": (config.backlash, config.backlash)},
    }
    return {name: _changed(environment, drawn, change) for name, change in changes.items()}


def evaluate_disturbed(
    robot: Robot,
    physics: SettleConfig | EngineConfig,
    policy_config: PolicyConfig,
    config: RobustnessConfig,
    policy: Policy,
    targets: Mapping[str, np.ndarray],
    seed: int,
    advance=None,
) -> dict[str, dict[tuple[str, str], tuple[Evaluation, int]]]:
    """Disturbance -> (target set, controller) -> evaluation and targets left out, as `compare_controllers` gives it.

    The seed being the same, arm i is the same arm in every disturbance but for the disturbance itself.

    Raises:
        ConfigError: `targets` has too few that every controller reaches in time.
    """
    bases = tuple(dict.fromkeys((*config.bases, policy_config.base)))
    columns = {command_column(base) for base in bases}
    targets = first_in_time(
        robot, policy_config.environment, targets, columns, config.num_targets, "robustness.num_targets"
    )
    return {
        name: compare_controllers(
            robot,
            physics,
            dataclasses.replace(policy_config, environment=environment),
            policy,
            targets,
            seed,
            advance,
            bases,
        )
        for name, environment in disturbances(config, policy_config.environment).items()
    }


def _changed(
    environment: EnvironmentConfig, drawn: RandomisationConfig, change: Mapping[str, Any]
) -> EnvironmentConfig:
    return dataclasses.replace(environment, randomisation=dataclasses.replace(drawn, **change))


def _times(factor: float, interval: Interval) -> Interval:
    low, high = interval
    return factor * low, factor * high
