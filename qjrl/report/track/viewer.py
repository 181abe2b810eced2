"""The robot on its path as an animation in the report: a canvas to turn, a slider, the frames in base64."""

import base64
import json
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.report.page import Fragment
from qjrl.robot import configuration_from_joint_positions
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot

_FULL = 32_000
"""The largest coordinate as a 16-bit integer."""
_FRAMES = 400
"""At most so many pictures of the arm."""


def track_viewer(robot: Robot, time: np.ndarray, joint_positions: np.ndarray, planned: np.ndarray) -> Fragment:
    """HTML of the animation; it needs nothing from elsewhere.

    Args:
        time: (n,) [s].
        joint_positions: (n, nq) of the physics.
        planned: (k, 3) the path [m].
    """
    chosen = np.unique(np.linspace(0, len(time) - 1, min(len(time), _FRAMES)).astype(int))
    points = _skeletons(robot, joint_positions[chosen])
    unit = max(float(np.abs(points).max()), float(np.abs(planned).max())) / _FULL
    data = {
        "unit": unit,
        "time": [round(float(value), 4) for value in time[chosen]],
        "points": points.shape[1],
        "segments": verb(robot, "drawing").sections(robot),
        "radius": verb(robot, "drawing").radius(robot),
        "arm": _encoded(points / unit),
        "path": _encoded(planned / unit),
    }
    script = Path(__file__).with_name("viewer.js").read_text(encoding="utf-8")
    return Fragment(
        '<div class="viewer"><p class="boxes"><button type="button">Pause</button>'
        '<input type="range" min="0" max="1000" value="0" aria-label="Time" style="flex: 1; min-width: 8rem">'
        '<select aria-label="Speed"><option value="0.1">a tenth of real speed</option>'
        '<option value="0.25" selected>a quarter</option><option value="1">real speed</option></select><output></output></p>'
        '<canvas tabindex="0" role="img" aria-label="The arm follows its path; turns with the mouse or the arrow keys"></canvas>'
        f'<script type="application/json">{json.dumps(data)}</script><script>\n{script}</script></div>'
    )


def _skeletons(robot: Robot, joint_positions: np.ndarray) -> np.ndarray:
    """From the base to the tip (n, points, 3) [m], by the closed form at the configurations that the physics had."""

    @jax.jit
    def points(robot: Robot, positions: jax.Array) -> jax.Array:
        configurations = jax.vmap(partial(configuration_from_joint_positions, robot))(positions)
        return jax.vmap(partial(verb(robot, "drawing").skeleton, robot))(configurations)

    return np.asarray(points(robot, jnp.asarray(joint_positions)))


def _encoded(points: np.ndarray) -> str:
    return base64.b64encode(np.round(points).astype("<i2").tobytes()).decode("ascii")
