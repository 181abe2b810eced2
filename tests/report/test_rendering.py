import os
import subprocess
import sys

import numpy as np
import pytest

from qjrl.report.rendering import image_png, render_arm
from qjrl.robot import load_robot

PROGRAM = """
import numpy as np
from qjrl.report.rendering import render_arm
from qjrl.robot import load_robot
assert render_arm(load_robot("qj_22"), np.zeros(20), 64, 48) is None
"""


def test_without_a_renderer_there_is_no_picture_and_no_error():
    environment = {**os.environ, "MUJOCO_GL": "disable"}
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, env=environment, timeout=120)


@pytest.mark.skipif(sys.platform != "linux", reason="GLFW is the way to render elsewhere")
def test_an_opengl_that_needs_a_screen_is_not_tried_since_a_second_failure_aborts_the_process():
    environment = {**os.environ, "MUJOCO_GL": "glfw", "DISPLAY": ""}
    subprocess.run([sys.executable, "-c", PROGRAM + PROGRAM], check=True, env=environment, timeout=120)


def test_a_rendering_is_a_picture_of_its_size_where_it_works():
    image = render_arm(load_robot("qj_22"), np.zeros(20), 64, 48)
    if image is not None:
        assert image.shape == (48, 64, 3)
        assert image.std() > 1.0
        assert image_png(image).startswith(b"\x89PNG")


def test_wrong_joint_positions_are_no_error_either():
    assert render_arm(load_robot("qj_22"), np.zeros(3)) is None
