"""The arm on its path as an animation in the report: a canvas to turn, a slider, the frames in base64."""

import base64
import json
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.report.page import Fragment
from qjrl.robot import configuration_from_joint_positions
from qjrl.robot.quaternion_arm.description import QuaternionArm, require_arm
from qjrl.robot.quaternion_arm.kinematics import frames
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
        "segments": np.repeat(np.arange(robot.num_segments), 2 * np.array(robot.joints_per_segment)).tolist(),
        "radius": robot.config.mechanics.link_radius,
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
    """Base and both ends of every link (n, points, 3) [m], by the closed form at the bends that the physics had."""
    poses = np.asarray(_all_frames(require_arm(robot, "the film of a path"), jnp.asarray(joint_positions)))[:, :, :3]
    return np.concatenate([np.zeros((len(poses), 1, 3)), poses], axis=1)


@jax.jit
def _all_frames(robot: QuaternionArm, joint_positions: jax.Array) -> jax.Array:
    bends = jax.vmap(partial(configuration_from_joint_positions, robot))(joint_positions)
    return jax.vmap(partial(frames, robot))(bends)


def _encoded(points: np.ndarray) -> str:
    return base64.b64encode(np.round(points).astype("<i2").tobytes()).decode("ascii")
