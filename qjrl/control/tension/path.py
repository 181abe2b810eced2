"""Places along a path to look at the strands in: rows of cable lengths as a file holds them, or poses as `track` runs them."""

from pathlib import Path

import jax
import numpy as np

from qjrl.config import ConfigError
from qjrl.control.path.files import ALLOWED_COLUMNS, POSE_LAYOUTS
from qjrl.control.path.inversion import PathInversionConfig, invert_path
from qjrl.control.path.paths import PosePath, ShapeConfig, make_path
from qjrl.control.tension.poses import PoseSet
from qjrl.robot import bends_from_cables, forward_kinematics
from qjrl.robot.kinds import verb
from qjrl.robot.plausibility import LARGEST_PLANNED, check_cable_lengths
from qjrl.robot.verbs import Robot
from qjrl.simulation.row_by_row import row_by_row
from qjrl.table_file import FILE_KINDS, Quantity, column_named, names_in, read_table

_KEY = "pretension.path"


def path_poses(robot: Robot, source: str, count: int, seed: int = 0) -> PoseSet:
    """At most `count` places along a path, evenly apart, first and last among them.

    Poses are inverted on the closed form by the stage `track`'s inversion at its defaults, along the smooth curve through
    them; where a file holds positions alone, orientation is free.

    Args:
        source: as `read_path`.
        seed: of the inversion's first guesses.
    Raises:
        ConfigError: as `read_path`, or a path that the arm does not reach.
    """
    path = read_path(robot, source)
    if isinstance(path, PosePath):
        cables = invert_path(robot, None, path, PathInversionConfig(), seed)
        path = np.asarray(cables.lengths(path.distance), np.float64)
    return _of_lengths(robot, path[np.unique(np.linspace(0, len(path) - 1, min(count, len(path))).round().astype(int))])


def read_path(robot: Robot, source: str) -> np.ndarray | PosePath:
    """Rows of cable lengths (n, cables) [m], or the path through the poses of a file.

    Args:
        source: `.csv` with one column a cable [m], named `cable_3` or `3` for the cable 3, in any order; `.npz` with
            `cable_lengths` (n, cables) [m], as a tracked trajectory holds them, in the order of its `cable_names` or of the
            description; or what `make_path` reads.
    Raises:
        ConfigError: missing file, other columns, values that are not finite or that the arm cannot have; one line.
    """
    file = Path(source)
    if file.suffix not in FILE_KINDS:
        raise ConfigError(f"{_KEY}: got '{source}', allowed: a file that ends in {' or '.join(FILE_KINDS)}")
    cables = cable_quantity(robot)
    try:
        if not _holds_cables(file, cables):
            return make_path(source, ShapeConfig(), _KEY, robot)
        allowed = f"{','.join(cables.columns)} [m] in any order, or {ALLOWED_COLUMNS}"
        rows = read_table(file, ((cables,), *POSE_LAYOUTS), allowed) if file.suffix == ".csv" else _of_npz(file, cables)
        check_cable_lengths(robot, rows["cable_lengths"], str(file), LARGEST_PLANNED)
    except ConfigError as error:
        raise error if str(error).startswith(_KEY) else ConfigError(f"{_KEY}: {error}") from error
    return rows["cable_lengths"]


def cable_quantity(robot: Robot) -> Quantity:
    """Cable lengths in the order of the description, by the cables' names on the machine."""
    names = verb(robot, "cable_names")(robot)
    numbers = {name: name.removeprefix("cable_") for name in names}
    aliases = {text: name for name, n in numbers.items() for text in (n, f"c{n}", f"cable {n}")}
    return Quantity("cable_lengths", names, "m", aliases, "cable_names")


def _holds_cables(file: Path, cables: Quantity) -> bool:
    """Whether a file is read as cable lengths: unless its names are those of poses."""
    names = names_in(file)
    if file.suffix == ".npz":
        return cables.name in names or not {one.name for layout in POSE_LAYOUTS for one in layout} & {*names}
    quantities = [one for layout in POSE_LAYOUTS for one in layout]
    return not any(column_named(name, quantities) for name in names)


def _of_npz(file: Path, cables: Quantity) -> dict[str, np.ndarray]:
    """Cable lengths go before poses, which files of the package hold beside them."""
    layouts = ((cables,),) if cables.name in names_in(file) else ((cables,), *POSE_LAYOUTS)
    return read_table(file, layouts, "")


def _of_lengths(robot: Robot, lengths: np.ndarray) -> PoseSet:
    bends, pose = row_by_row(_bends_and_pose, robot, lengths)
    return PoseSet(lengths, np.asarray(bends), np.asarray(pose))


def _bends_and_pose(robot: Robot, lengths: jax.Array) -> tuple[jax.Array, jax.Array]:
    bends = bends_from_cables(robot, lengths)
    return bends, forward_kinematics(robot, bends)
