"""Commands of bends by the nominal model, and the rows that an independent prototype has found for them."""

import dataclasses

import numpy as np

from qjrl.robot.continuum_arm.plant import Plant, nominal_plant

LENGTH, RADIUS = 0.12, 0.067
BENDS = np.array(
    [
        np.zeros((4, 2)),
        np.tile([0.5, 0.0], (4, 1)),
        np.tile([0.0, 0.5], (4, 1)),
        [(0.6, -0.3), (-0.2, 0.7), (0.4, 0.4), (-0.5, 0.1)],
    ]
)
TIPS = np.array([(31.008, 0, 477.713), (346.281, 0, 215.360), (107.280, 320.852, 218.331), (239.202, 124.738, 335.761)])
"""[mm]."""
TURNS = np.array([(0, 2.802, 0), (0, 113.704, 0), (-113.799, 13.797, -23.445), (-49.807, 24.136, 8.071)])
"""[deg]."""
TENSIONS = np.array(
    [(0, 29.08, 83.56, 29.08), (22.07, 27.96, 34.34, 27.96), (20.72, 45.76, 75.17, 64.29), (25.67, 40.51, 52.03, 28.57)]
)
"""Of the first segment's cables [N]."""


def commands_of(bends: np.ndarray, num_cables: int = 4) -> np.ndarray:
    """Lengths of cables (..., S, C) relative to home [m] of segments that are circular arcs of these bends (..., S, 2)."""
    angle = np.linalg.norm(bends, axis=-1, keepdims=True)
    ratio = np.where(angle < 1e-9, 1.0, 2.0 * np.sin(angle / 2.0) / np.maximum(angle, 1e-9))
    azimuth = -2.0 * np.pi / num_cables * np.arange(num_cables)
    return ratio * (LENGTH - RADIUS * (bends @ np.stack([np.cos(azimuth), np.sin(azimuth)]))) - LENGTH


def frictionless_plant(num_segments: int = 4, num_cables: int = 4, **numbers) -> Plant:
    return nominal_plant(
        length=[LENGTH] * num_segments, anchor_radius=RADIUS, num_cables=num_cables, **{"friction": 0.0, **numbers}
    )


def as_the_prototype_weighed(plant: Plant, steps: int) -> Plant:
    """The plant whose hoses have the prototype's weight: by the trapezoidal rule over the steps, less the first node.

    Half a step's mass is missing at the base of every hose, which is the disc of the segment before. The rule itself adds
    m L / (12 steps^2) times the change of the rod's direction to the first moment: discs' masses cancel but for the last.
    """
    missing = np.append(plant.hose_mass[1:], 0.0) / (2.0 * steps)
    rule = np.zeros_like(missing)
    rule[-1] = plant.hose_mass[-1] * plant.length[-1] / (12.0 * steps**2)
    mass = plant.disc_mass - missing
    return dataclasses.replace(plant, disc_mass=mass, disc_depth=(plant.disc_mass * plant.disc_depth - rule) / mass)
