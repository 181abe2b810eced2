import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qjrl.config import ConfigError
from qjrl.control.path.paths import CircleConfig, LineConfig, ShapeConfig, make_path

CIRCLE = ShapeConfig(circle=CircleConfig((0.1, 0.2, 0.3), 0.05, (1.0, 2.0, 2.0), 30.0))
HEADER = "x,y,z,qw,qx,qy,qz\n"


def frames(poses):
    x, y = poses[:, 3:6], poses[:, 6:9]
    return np.stack([x, y, np.cross(x, y)], axis=2)


def test_a_circle_is_round_flat_closed_and_evenly_spaced() -> None:
    path = make_path("circle", CIRCLE)
    offset = path.pose[:, :3] - [0.1, 0.2, 0.3]
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 0.05, atol=1e-9)
    np.testing.assert_allclose(offset @ [1.0, 2.0, 2.0], 0.0, atol=1e-9)
    assert path.length == pytest.approx(2 * np.pi * 0.05, rel=1e-6) and path.is_closed
    chords = np.linalg.norm(np.diff(offset, axis=0), axis=1)
    np.testing.assert_allclose(chords, chords[0], rtol=1e-4)
    assert np.all(np.cross(offset[:-1], offset[1:]) @ [1.0, 2.0, 2.0] > 0)  # anticlockwise about the normal


def test_a_line_keeps_its_direction_and_its_orientation() -> None:
    shape = ShapeConfig(
        "fixed", rotation_vector_deg=(0.0, 90.0, 0.0), line=LineConfig((0.0, 0.0, 0.4), (0.0, 0.03, 0.44))
    )
    path = make_path("line", shape)
    assert path.length == pytest.approx(0.05) and path.constraint == "pose" and not path.is_closed
    np.testing.assert_allclose(path.pose[:, :3], [0, 0, 0.4] + path.distance[:, None] * [0, 0.6, 0.8], atol=1e-9)
    np.testing.assert_allclose(path.pose[:, 3:], np.tile([0, 0, -1, 0, 1, 0], (len(path.pose), 1)), atol=1e-12)


def test_a_tangent_tip_leans_towards_the_direction_of_travel() -> None:
    shape = ShapeConfig("tangent", lean_deg=25.0, circle=CIRCLE.circle)
    path = make_path("circle", shape)
    normal = np.array([1.0, 2.0, 2.0]) / 3.0
    travel = np.cross(normal, path.pose[:, :3] - [0.1, 0.2, 0.3]) / 0.05
    z = frames(path.pose)[:, :, 2]
    np.testing.assert_allclose(z, np.cos(np.radians(25)) * normal + np.sin(np.radians(25)) * travel, atol=1e-5)
    assert path.constraint == "pointing" and path.is_closed


def random_poses(count):
    random = np.random.default_rng(3)
    angle = np.linspace(0.0, 1.5, count)[:, None]
    position = 0.1 * np.hstack([np.cos(angle), np.sin(angle), 4 + 0.3 * angle]) + 0.003 * random.normal(size=(count, 3))
    return position, Rotation.from_rotvec(angle * [0.2, 0.1, 0.3])


def write(path, position, rotation, kind):
    quaternion, matrix = rotation.as_quat(scalar_first=True), rotation.as_matrix()
    columns = np.concatenate([matrix[:, :, 0], matrix[:, :, 1]], axis=1)
    if kind == "quaternion.csv":
        np.savetxt(
            path, np.hstack([position, quaternion]), delimiter=",", header=HEADER.strip(), comments="", fmt="%.17g"
        )
    elif kind == "columns.csv":
        names = "x,y,z,xx,xy,xz,yx,yy,yz"
        np.savetxt(path, np.hstack([position, columns]), delimiter=",", header=names, comments="", fmt="%.17g")
    elif kind == "quaternion.npz":
        np.savez(path, position=position, quaternion=-quaternion)  # the other cover
    else:
        np.savez(path, pose=np.hstack([position, columns]))
    return str(path)


def test_a_file_in_every_form_is_the_same_smooth_path_through_its_points(tmp_path) -> None:
    position, rotation = random_poses(9)
    kinds = ("quaternion.csv", "columns.csv", "quaternion.npz", "pose.npz")
    paths = [make_path(write(tmp_path / kind, position, rotation, kind), ShapeConfig()) for kind in kinds]
    for path in paths:
        assert path.constraint == "pose"
        np.testing.assert_allclose(path.pose, paths[0].pose, atol=1e-9)
    fine = paths[0].at(np.linspace(0.0, paths[0].length, 20_001))
    for point, frame in zip(position, rotation.as_matrix(), strict=True):
        nearest = np.argmin(np.linalg.norm(fine[:, :3] - point, axis=1))
        np.testing.assert_allclose(fine[nearest, :3], point, atol=2e-5)
        np.testing.assert_allclose(frames(fine[nearest : nearest + 1])[0], frame, atol=2e-3)
    steps = np.diff(fine[::20, :3], axis=0)
    turns = np.sum(steps[1:] * steps[:-1], axis=1) / np.prod(
        [np.linalg.norm(s, axis=1) for s in (steps[1:], steps[:-1])], 0
    )
    assert turns.min() > 0.995  # no corner at a point


def test_positions_alone_leave_the_orientation_free_unless_it_is_fixed(tmp_path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("z,x,y\n0.4,0,0\n0.4,0.02,0\n0.42,0.04,0\n")
    path = make_path(str(file), ShapeConfig())
    assert path.constraint == "position"
    np.testing.assert_allclose(path.pose[[0, -1], :3], [[0, 0, 0.4], [0.04, 0, 0.42]], atol=1e-12)
    assert make_path(str(file), ShapeConfig("fixed")).constraint == "pose"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot be read"),
        ("", "no header"),
        ("a,b,c\n1,2,3\n", "columns a,b,c"),
        ("x,y,z\n0,0,0.4\n", "holds 1 points"),
        ("x,y,z\n0,0,0.4\n0,nan,0.4\n", "row 1 .*line 3, column y: got nan, which is not finite"),
        ("x,y,z\n0,0,0.4\n0,0.1\n", "does not hold 3 numbers"),
        ("x,y,z\n0,0,0.4\n0,zero,0.4\n", "zero"),
        ("x,y,z\n0,0,0.4\n0,0.1,0.4\n0,0.1,0.4\n", "points 1 and 2 are the same"),
        ("x,y,z\n0,0,0.4\n0,0.001,0.4\n", "is 1 mm long"),
        (HEADER + "0,0,0.4,1,0,0,0\n0,0.1,0.4,1,1,0,0\n", "point 1 .* no unit quaternion"),
    ],
)
def test_a_file_that_is_no_path_is_one_line(tmp_path, content, words) -> None:
    file = tmp_path / "path.csv"
    if content is not None:
        file.write_text(content)
    with pytest.raises(ConfigError, match=words) as caught:
        make_path(str(file), ShapeConfig())
    assert "\n" not in str(caught.value) and ("path.csv" in str(caught.value))


def test_arrays_of_other_names_and_unknown_sources_are_refused(tmp_path) -> None:
    np.savez(tmp_path / "path.npz", points=np.zeros((3, 3)))
    with pytest.raises(ConfigError, match=r"holds points \(3, 3\), allowed: position"):
        make_path(str(tmp_path / "path.npz"), ShapeConfig())
    (tmp_path / "broken.npz").write_bytes(b"no zip")
    with pytest.raises(ConfigError, match="truncated or not a"):
        make_path(str(tmp_path / "broken.npz"), ShapeConfig())
    with pytest.raises(ConfigError, match=r"track\.path: got 'square', allowed: circle, line"):
        make_path("square", ShapeConfig())
