import sys

import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from qjrl.geometry.mesh import cylinder
from qjrl.report import canvas, error_figures
from qjrl.report.compare import strand_figures, training_figures
from qjrl.report.outcomes import Outcome
from qjrl.report.palette import DARK, LIGHT, SERIES, series_colour
from qjrl.report.robot_drawing import FRONT, draw_robot, oblique
from qjrl.robot import forward_kinematics, load_robot
from qjrl.robot.quaternion_arm.drawing import arm_mesh

RECORDS = [{"epoch": epoch, "loss": None if epoch == 0 else 1.0 / epoch, "error": 5.0 - epoch} for epoch in range(4)]


def outcomes() -> list[Outcome]:
    rng = np.random.default_rng(0)
    errors, tension = rng.lognormal(-6.0, 0.5, 60), np.maximum(rng.normal(15.0, 8.0, (60, 16)), 0.0)
    return [
        Outcome(name, "uniform", errors * scale, errors, tension, tension <= 0.0)
        for name, scale in (("nominal", 3.0), ("learned_ik", 1.0), ("mine", 0.5))
    ]


FIGURES = {
    "cumulative": lambda: error_figures.cumulative_errors(outcomes(), "orientation"),
    "predicted": lambda: error_figures.predicted_and_real(np.array([1e-4, 2e-3]), np.array([1e-3, 0.0])),
    "against": lambda: error_figures.error_against(
        np.arange(60.0), {o.controller: o.position_error for o in outcomes()}, "distance from home [mm]"
    ),
    "training": lambda: training_figures.learning_curves(
        RECORDS, {"loss": "loss", "absent": "absent"}, "epoch", "epoch", "loss [–]", True, {"base": 0.5}
    ),
    "nothing": lambda: training_figures.learning_curves([], {"loss": "loss"}, "epoch", "epoch", "loss [–]", True),
    "tension": lambda: strand_figures.tension_histogram(outcomes(), 15.0),
}


@pytest.mark.parametrize("name", FIGURES)
def test_figures_come_without_global_state(name):
    before, loaded = dict(matplotlib.rcParams), set(sys.modules)
    figure = FIGURES[name]()
    png = canvas.as_png(figure, 40)
    assert isinstance(figure, Figure)
    assert png.startswith(b"\x89PNG")
    assert canvas.png_data_uri(png).startswith("data:image/png;base64,")
    assert dict(matplotlib.rcParams) == before
    assert "matplotlib.pyplot" not in set(sys.modules) - loaded


@pytest.mark.parametrize("name", FIGURES)
def test_axes_carry_units_or_counts(name):
    for axes in FIGURES[name]().axes:
        assert "[" in axes.get_title(loc="left")
        assert "[" in axes.get_xlabel() or axes.get_xlabel() == "epoch"


def test_the_same_figure_gives_the_same_bytes(tmp_path):
    canvas.save_png(FIGURES["cumulative"](), tmp_path / "one.png", 40)
    canvas.save_png(FIGURES["cumulative"](), tmp_path / "two.png", 40)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    assert canvas.as_svg(FIGURES["training"](), "a") == canvas.as_svg(FIGURES["training"](), "a")


def test_cumulative_curve_passes_through_the_median():
    axes = FIGURES["cumulative"]().axes[0]
    median = np.degrees(np.median(outcomes()[0].orientation_error))
    curve, dot = (np.asarray(line.get_xydata()) for line in axes.lines[:2])
    assert np.interp(50.0, curve[:, 1], curve[:, 0]) == pytest.approx(median, rel=0.02)
    assert dot[0] == pytest.approx([median, 50.0])


def test_a_curve_leaves_out_what_a_record_lacks():
    steps, values = training_figures.curve(RECORDS, "epoch", "loss")
    assert steps.tolist() == [1.0, 2.0, 3.0]
    assert values.tolist() == pytest.approx([1.0, 0.5, 1.0 / 3.0])


def test_colours_have_one_purpose_each_and_enough_contrast():
    assert set(LIGHT) == set(DARK)
    assert len(set(LIGHT.values())) == len(LIGHT)
    for name in ("ink", "muted", "good", "bad", *SERIES):
        least = 4.5 if name in ("ink", "muted", "good", "bad") else 3.0  # WCAG 2.2: text, and graphical objects
        assert _contrast(LIGHT[name], LIGHT["paper"]) >= least
        assert _contrast(DARK[name], DARK["paper"]) >= least
    assert series_colour(0) != series_colour(1)


@pytest.fixture(scope="module")
def arm():
    return load_robot("qj_2222")


def test_drawing_shows_the_arm_where_the_kinematics_put_it(arm):
    bends = np.array([[0.1, 0.2], [-0.2, 0.1], [0.15, 0.0], [0.0, -0.3]])
    tip = np.asarray(forward_kinematics(arm, jnp.asarray(bends)))[:3]
    corners = np.concatenate(arm_mesh(arm, bends).polygons)
    last_lid = arm_mesh(arm, bends).polygons[-2]
    assert last_lid.mean(axis=0) == pytest.approx(tip, abs=1e-6)
    assert np.abs(corners).max() < 0.6


@pytest.mark.parametrize("name", ["qj_2222", "qj_22"])
def test_drawing_has_three_views_with_scales(name):
    robot = load_robot(name)
    figure = draw_robot(robot, np.zeros((2, robot.num_segments, 2)), np.array([[0.1, 0, 0.2, 1, 0, 0, 0, 1, 0]]))
    assert len(figure.axes) == 3
    assert figure.axes[1].get_xlim() == pytest.approx(figure.axes[2].get_xlim())
    assert figure.axes[1].get_xlabel() == "x [mm]"
    assert len(draw_robot(robot, np.zeros((robot.num_segments, 2)), is_oblique_only=True).axes) == 1


@pytest.mark.parametrize("view", [FRONT, oblique(), oblique(200.0, -30.0)])
def test_views_are_rotations(view):
    assert view.axes @ view.axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(view.axes) == pytest.approx(1.0)


def test_cylinder_is_closed_and_wound_outwards():
    polygons = cylinder(lambda points: np.asarray(points), 0.0, 2.0, 1.0, num_sides=64)
    volume = sum(
        np.dot(polygon[0], np.cross(polygon[i], polygon[i + 1])) / 6.0
        for polygon in polygons
        for i in range(1, len(polygon) - 1)
    )
    assert volume == pytest.approx(2.0 * np.pi, rel=2e-3)  # positive: all outwards


def _contrast(one: str, other: str) -> float:
    low, high = sorted((_luminance(one), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    parts = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])
