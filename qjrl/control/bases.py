"""The controllers that a residual policy is added to, and their names."""

import dataclasses
from collections.abc import Mapping
from typing import Literal

import jax.numpy as jnp
import numpy as np

from qjrl.control.episode import Bank, EnvironmentConfig

Base = Literal["nominal", "learned", "integral", "dither", "dither_integral", "estimate"]
"""Inverse kinematics of the closed form; of the learned model; that with integral feedback from the encoders, with
dither, with both; with dither and feedback from `arm_estimate`."""


@dataclasses.dataclass(frozen=True)
class _Parts:
    """What a base consists of."""

    answers: str
    """Whose answers in a target bank it commands."""
    has_integral: bool
    has_dither: bool
    has_estimate: bool
    name: str
    """As a controller."""


_PARTS: dict[Base, _Parts] = {
    "nominal": _Parts("nominal", False, False, False, "nominal"),
    "learned": _Parts("learned", False, False, False, "learned_ik"),
    "integral": _Parts("learned", True, False, False, "learned_ik+integral"),
    "dither": _Parts("learned", False, True, False, "learned_ik+dither"),
    "dither_integral": _Parts("learned", True, True, False, "learned_ik+dither+integral"),
    "estimate": _Parts("learned", False, True, True, "learned_ik+dither+estimate"),
}
BASES: tuple[Base, ...] = tuple(_PARTS)


def controller_name(base: Base, has_policy: bool = False) -> str:
    """Name of a base as a controller, and of a policy on top of it: "learned_ik+dither+residual"."""
    return _PARTS[base].name + ("+residual" if has_policy else "")


def command_column(base: Base) -> str:
    """Column of a target bank that holds its commands."""
    return f"{_PARTS[base].answers}_lengths"


def bank_of(targets: Mapping[str, np.ndarray], base: Base, rows: np.ndarray) -> Bank:
    """Targets and base commands of some rows of a target bank."""
    return Bank(jnp.asarray(targets["target"][rows]), jnp.asarray(targets[command_column(base)][rows]))


def environment_of(config: EnvironmentConfig, base: Base) -> EnvironmentConfig:
    """The environment of a base: without the feedback and the dither that it lacks."""
    parts = _PARTS[base]
    if not parts.has_integral:
        config = dataclasses.replace(config, integral=dataclasses.replace(config.integral, gain=0.0))
    if not parts.has_estimate:
        config = dataclasses.replace(config, estimate=dataclasses.replace(config.estimate, acts=False))
    if not parts.has_dither:
        config = dataclasses.replace(config, dither=dataclasses.replace(config.dither, amplitude=0.0))
    return config
