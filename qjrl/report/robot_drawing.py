"""Drawings of a robot: oblique, from the front and from above, the same polygons projected three times."""

import dataclasses
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from qjrl.geometry.mesh import Frame, Mesh, cylinder
from qjrl.report.canvas import new_figure, style
from qjrl.report.palette import AXES, LIGHT, PARTS
from qjrl.robot.kinds import configuration_shape, verb
from qjrl.robot.verbs import Robot

_FOOT_HEIGHT = 0.005
"""Of the pedestal's foot [m]."""
_LIGHT_DIRECTION = np.array([-0.35, 0.55, 0.76])
"""Towards the light, in coordinates of the picture: right, up, towards the eye."""


@dataclasses.dataclass(frozen=True)
class View:
    """A parallel projection; the rows of `axes` are the picture's right, up and towards the eye, in the base frame."""

    axes: np.ndarray
    labels: tuple[str, str] | None = None
    """Of the picture's two axes; None: no scale, the floor is drawn instead."""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) [m] as right, up, depth [mm]."""
        return 1e3 * np.asarray(points) @ self.axes.T


def oblique(azimuth_deg: float = -58.0, elevation_deg: float = 20.0) -> View:
    """Seen from a direction given as on a globe, z up."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    eye = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return View(np.stack([right, np.cross(eye, right), eye]))


FRONT = View(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), ("x [mm]", "z [mm]"))
ABOVE = View(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), ("x [mm]", "y [mm]"))


@style()
def draw_robot(
    robot: Robot, configurations: np.ndarray, targets: np.ndarray | None = None, is_oblique_only: bool = False
) -> Figure:
    """The robot at one or more configurations, with its targets as small frames (x orange, y green, z blue).

    Args:
        configurations: (k, ...) or one.
        targets: (t, 9) poses [m, -], or none.
        is_oblique_only: leaves out the two projections with their scales.
    Raises:
        ConfigError: its kind has no drawing.
    """
    drawing = verb(robot, "drawing")
    configurations = np.asarray(configurations).reshape(-1, *configuration_shape(robot))
    targets = np.zeros((0, 9)) if targets is None else np.asarray(targets).reshape(-1, 9)
    mesh = sum((drawing.mesh(robot, one) for one in configurations), Mesh())
    low, high = _bounds(mesh, targets)
    floor = min(-0.06, low[2] - 0.02)
    standing = mesh + _pedestal(drawing.radius(robot), floor)
    if is_oblique_only:
        figure = new_figure(5.2, 4.6)
        _draw(figure.add_subplot(), oblique(), standing, targets, floor)
        return figure
    figure = new_figure(10.4, 5.6)
    heights = np.maximum(high - low, 0.15)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.4, 1.0], height_ratios=[heights[2], heights[1]])
    _draw(figure.add_subplot(grid[:, 0]), oblique(), standing, targets, floor)
    for row, (view, up) in enumerate(((FRONT, 2), (ABOVE, 1))):
        axes = figure.add_subplot(grid[row, 1])
        _draw(axes, view, mesh, targets)
        axes.set(xlim=1e3 * np.array([low[0], high[0]]), ylim=1e3 * np.array([low[up], high[up]]))
    return figure


def _pedestal(radius: float, floor: float) -> Mesh:
    """A column from the base down to a floor [m]."""
    mesh = Mesh()
    mesh.add(cylinder(Frame(), floor, -0.5 * _FOOT_HEIGHT, 0.75 * radius), "base")  # below the base plate
    mesh.add(cylinder(Frame(), floor, floor + _FOOT_HEIGHT, 1.8 * radius), "base")
    return mesh


def _draw(axes: Axes, view: View, mesh: Mesh, targets: np.ndarray, floor: float | None = None) -> None:
    axes.set_aspect("equal")
    if floor is not None:
        _draw_floor(axes, view, mesh, floor)
    _draw_mesh(axes, view, mesh)
    for target in targets:
        _draw_frame(axes, view, target)
    axes.autoscale_view()
    if view.labels is None:
        axes.set_axis_off()
        return
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid()
    axes.tick_params(length=0)
    axes.set_xlabel(view.labels[0])
    axes.set_title(view.labels[1])


def _draw_mesh(axes: Axes, view: View, mesh: Mesh) -> None:
    """Painter's algorithm: what faces away is left out, the rest is drawn from the back, shaded by its direction."""
    projected = [view(polygon) for polygon in mesh.polygons]
    normals = [_normal(polygon) for polygon in projected]
    visible = [index for index, normal in enumerate(normals) if normal is None or normal[2] > 0.0]
    visible.sort(key=lambda index: projected[index][:, 2].mean())
    colours = [_shaded(PARTS[mesh.parts[index]], normals[index]) for index in visible]
    widths = [0.6 if normals[index] is None else 0.35 for index in visible]
    faces = [projected[index][:, :2] for index in visible]
    axes.add_collection(
        PolyCollection(faces, facecolors=colours, edgecolors=colours, linewidths=widths, rasterized=True, zorder=3)
    )


def _draw_floor(axes: Axes, view: View, mesh: Mesh, floor: float) -> None:
    """Squares of 100 mm, and the robot's shadow straight below it."""
    points = np.concatenate(mesh.polygons)
    low, high = (np.floor(10.0 * points.min(0)) - 0.5) / 10.0, (np.ceil(10.0 * points.max(0)) + 0.5) / 10.0
    xs, ys = (np.arange(low[i] + 0.05, high[i], 0.1) for i in (0, 1))
    lines = [[(x, low[1], floor), (x, high[1], floor)] for x in xs] + [
        [(low[0], y, floor), (high[0], y, floor)] for y in ys
    ]
    axes.add_collection(
        LineCollection([view(np.array(line))[:, :2] for line in lines], colors=LIGHT["rule"], linewidths=0.8)
    )
    axes.add_patch(PathPatch(_shadow(view, mesh, floor), facecolor=LIGHT["rule"], edgecolor="none", zorder=2))


def _shadow(view: View, mesh: Mesh, floor: float) -> Path:
    """One outline of all that faces upwards: wound the same way everywhere, so that nothing cancels or adds up."""
    corners = []
    for polygon in mesh.polygons:
        normal = _normal(polygon)
        if normal is not None and normal[2] > 0.0:
            corners.append(view(np.column_stack([polygon[:, :2], np.full(len(polygon), floor)]))[:, :2])
    return Path.make_compound_path(*(Path(polygon, closed=False) for polygon in corners))


def _draw_frame(axes: Axes, view: View, pose: np.ndarray, size: float = 0.045) -> None:
    """The axes of a target, and a ring where it is."""
    x, y = pose[3:6], pose[6:9]
    origin = view(pose[:3])
    for direction, colour in zip((x, y, np.cross(x, y)), AXES, strict=True):
        tip = view(pose[:3] + size * direction)
        axes.plot([origin[0], tip[0]], [origin[1], tip[1]], color=LIGHT["paper"], linewidth=3.6, zorder=4)
        axes.plot([origin[0], tip[0]], [origin[1], tip[1]], color=colour, linewidth=2.0, zorder=5)
    axes.plot(*origin[:2], "o", color=LIGHT["paper"], markeredgecolor=LIGHT["ink"], markersize=4.5, zorder=6)


def _normal(polygon: np.ndarray) -> np.ndarray | None:
    """Unit normal of a flat polygon, None for a line and for what has no area."""
    if len(polygon) < 3:
        return None
    normal = np.cross(polygon[1] - polygon[0], polygon[2] - polygon[1])
    length = np.linalg.norm(normal)
    return normal / length if length > 0.0 else None


def _shaded(colour: str, normal: np.ndarray | None) -> tuple[float, float, float]:
    if normal is None:
        return to_rgb(colour)
    brightness = 0.62 + 0.62 * max(0.0, float(normal @ _LIGHT_DIRECTION))
    red, green, blue = (min(1.0, brightness * part) for part in to_rgb(colour))
    return red, green, blue


def _bounds(mesh: Mesh, targets: np.ndarray, margin: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates [m] of all that is drawn."""
    points = np.concatenate([*mesh.polygons, targets[:, :3]])
    return points.min(0) - margin, points.max(0) + margin
