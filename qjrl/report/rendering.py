"""Pictures of the physics by MuJoCo's own renderer, where this machine has an OpenGL that needs no screen.

MUJOCO_GL must have been set before mujoco was first imported; the command does that.
"""

import importlib
import io
import logging
import sys
from typing import Any

import numpy as np

from qjrl.robot import build_mjcf
from qjrl.robot.kinds import verb
from qjrl.robot.verbs import Robot

log = logging.getLogger(__name__)


def render_arm(
    robot: Robot, joint_positions: np.ndarray, width: int = 960, height: int = 720, azimuth: float = 125.0
) -> np.ndarray | None:
    """The arm at joint positions (nq,), or None where nothing can be rendered: that is no failure of a run.

    Args:
        azimuth: direction of the eye about z [deg].
    Returns:
        (height, width, 3) uint8.
    """
    if _needs_a_screen():
        log.info("no rendering by MuJoCo: its OpenGL needs a screen; set MUJOCO_GL to egl or osmesa")
        return None
    try:
        return _render(robot, np.asarray(joint_positions, np.float64), width, height, azimuth)
    except Exception as error:  # drivers fail in ways of their own, and a picture is never worth a run
        log.info("no rendering by MuJoCo: %s", " ".join(str(error).split()) or type(error).__name__)
        return None


def image_png(image: np.ndarray) -> bytes:
    """An image (height, width, 3) uint8 as the bytes of a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def _render(robot: Robot, joint_positions: np.ndarray, width: int, height: int, azimuth: float) -> np.ndarray:
    mujoco = _mujoco()
    spec = mujoco.MjSpec.from_string(build_mjcf(robot))
    points = _middles(spec.compile(), joint_positions)
    _furnish(spec, robot, min(-0.08, float(points[:, 2].min()) - 0.04), (width, height))
    model = spec.compile()
    data = _posed(model, joint_positions)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (points.min(0) + points.max(0)) / 2.0
    camera.distance = 0.3 + 1.4 * float(np.linalg.norm(points - camera.lookat, axis=1).max())
    camera.azimuth, camera.elevation = azimuth, -16.0
    renderer = mujoco.Renderer(model, height, width)
    try:
        renderer.update_scene(data, camera, _options())
        return renderer.render().copy()
    finally:
        renderer.close()


def _needs_a_screen() -> bool:
    """GLFW, which mujoco takes on Linux if not told otherwise: without a screen, a second try aborts the process."""
    context = getattr(_mujoco(), "GLContext", None)
    return sys.platform == "linux" and getattr(context, "__module__", None) == "mujoco.glfw"


def _posed(model, joint_positions: np.ndarray):
    mujoco = _mujoco()
    data = mujoco.MjData(model)
    data.qpos[:] = joint_positions
    mujoco.mj_forward(model, data)
    return data


def _middles(model, joint_positions: np.ndarray) -> np.ndarray:
    """The middles of all bodies' shapes, and the base (n, 3) [m]."""
    return np.concatenate([_posed(model, joint_positions).geom_xpos, np.zeros((1, 3))])


def _furnish(spec, robot: Robot, floor: float, size: tuple[int, int]) -> None:
    """A light, a bright sky, a floor [m] and a column under the base; none of it touches the physics."""
    mujoco = _mujoco()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.quality.offsamples, spec.visual.quality.shadowsize = 8, 4096
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.98, 0.985, 0.99], rgb2=[0.86, 0.89, 0.92], width=256, height=256,
    )  # fmt: skip
    light = spec.worldbody.add_light(pos=[0.9, -1.1, 2.6], dir=[-0.3, 0.37, -0.88], castshadow=True)
    light.cutoff, light.exponent, light.diffuse = 75.0, 0.0, [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse, spec.visual.headlight.specular = [0.4, 0.4, 0.4], [0.1, 0.1, 0.1]
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[3.0, 3.0, 0.1], pos=[0.0, 0.0, floor], rgba=[0.86, 0.89, 0.92, 1.0]
    )
    radius = 0.75 * verb(robot, "drawing").radius(robot)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[radius, -floor / 2.0, 0.0], pos=[0.0, 0.0, floor / 2.0],
        rgba=[0.62, 0.66, 0.70, 1.0],
    )  # fmt: skip


def _options():
    """Strands are shown, sites and joints are not."""
    mujoco = _mujoco()
    options = mujoco.MjvOption()
    mujoco.mjv_defaultOption(options)
    options.flags[mujoco.mjtVisFlag.mjVIS_TENDON] = True
    options.flags[mujoco.mjtVisFlag.mjVIS_JOINT] = False
    return options


def _mujoco() -> Any:
    """Imported when first used; its compiled parts have no types."""
    return importlib.import_module("mujoco")
