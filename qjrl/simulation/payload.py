"""The last body of an arm's MuJoCo model with another payload: a ball whose centre is the site `tip`."""

import dataclasses
from typing import Any

import mujoco
import numpy as np

from qjrl.robot.plant import PAYLOAD_RADIUS
from qjrl.robot.verbs import Robot


@dataclasses.dataclass(frozen=True)
class TipBody:
    """What MuJoCo knows of the body that carries the payload, one row a simulation."""

    mass: Any
    """(n,) [kg]."""
    centre: Any
    """(n, 3) of mass, in the body's frame [m]."""
    inertia: Any
    """(n, 3) about the centre of mass, along the principal axes of the model [kg m^2]."""


def tip_body(robot: Robot, model: mujoco.MjModel, payload: Any) -> TipBody:
    """The model's last body with payloads (n,) [kg] in place of the one described.

    The centres of both lie on a principal axis of the body, which therefore keeps its principal axes: two masses a
    distance d apart add m1 m2 / (m1 + m2) d^2 about the axes across (Steiner).
    """
    site = model.site("tip").id
    body = model.site_bodyid[site]
    mass, centre = model.body_mass[body], model.body_ipos[body]
    added = payload - robot.payload
    between = model.site_pos[site] - centre
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    along = axes.reshape(3, 3).T @ between
    reduced = (mass * added / (mass + added))[:, None]
    return TipBody(
        mass + added,
        centre + (added / (mass + added))[:, None] * between,
        model.body_inertia[body] + 0.4 * PAYLOAD_RADIUS**2 * added[:, None] + reduced * (along @ along - along**2),
    )
