"""What is wrong with one continuum arm and not with another: drawn from a seed, a stream of numbers a kind of defect."""

import dataclasses
import math
from typing import Annotated

import jax
import numpy as np

from qjrl.config import Range, configuration
from qjrl.keys import Purpose, key_for
from qjrl.robot.continuum_arm.plant import Plant


@configuration
class DefectSizes:
    """Standard deviations of normal draws. All are ours: the paper names no tolerance."""

    anchor: Annotated[float, Range(low=0.0)] = 5e-4
    """Of each coordinate of each anchor on both discs of a segment [m]."""
    home_length: Annotated[float, Range(low=0.0)] = 5e-4
    """Of each cable's length at home [m]."""
    cable_gain: Annotated[float, Range(low=0.0)] = 0.01
    """Of each cable's change of length for one of its command, about 1."""
    tip_frame_deg: Annotated[float, Range(0.0, 90.0)] = 0.3
    """Of each component of the rotation from the last disc to the measured tip [deg]."""
    preset_bend: Annotated[float, Range(low=0.0)] = 0.05
    """Of the bend of each rod without load, in x and in y [rad]."""


def with_defects(plant: Plant, sizes: DefectSizes, seed: int) -> Plant:
    """The plant with defects of a seed on top of those that it has. The same seed gives the same bits.

    Sizes only scale the draws: twice a size is twice the same defects, and a size of zero leaves the others as they are.
    """

    def draw(purpose: Purpose, size: float, shape: tuple[int, ...]) -> np.ndarray:
        return size * np.asarray(jax.random.normal(key_for(seed, purpose), shape, float))

    anchors = draw("anchors of a continuum arm", sizes.anchor, (2, *plant.lower_anchors.shape))
    cables = plant.home_offset.shape
    return dataclasses.replace(
        plant,
        lower_anchors=plant.lower_anchors + anchors[0],
        upper_anchors=plant.upper_anchors + anchors[1],
        home_offset=plant.home_offset + draw("home lengths of a continuum arm", sizes.home_length, cables),
        cable_gain=plant.cable_gain + draw("cable gains of a continuum arm", sizes.cable_gain, cables),
        tip_rotation=plant.tip_rotation
        + draw("tip frame of a continuum arm", math.radians(sizes.tip_frame_deg), plant.tip_rotation.shape),
        preset_bend=plant.preset_bend
        + draw("preset bends of a continuum arm", sizes.preset_bend, plant.preset_bend.shape),
    )
