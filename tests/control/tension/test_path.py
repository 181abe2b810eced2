import numpy as np
import pytest
from arms import arm_named
from scipy.spatial.transform import Rotation

from qjrl.artifacts import write_arrays
from qjrl.config import ConfigError
from qjrl.control.tension.path import path_poses
from qjrl.control.tension.poses import workspace_poses

ARM = arm_named("qj_22")
POSES = workspace_poses(ARM, "even", 16, seed=0)
POINTS = np.array([[-0.02, 0.0, 0.225], [0.0, 0.01, 0.23], [0.02, 0.0, 0.225]])


def test_cable_lengths_are_taken_row_by_row(tmp_path):
    lengths = POSES.cable_lengths
    write_arrays(tmp_path / "trajectory.npz", {"time": np.arange(16), "cable_lengths": lengths})
    np.savetxt(tmp_path / "named.csv", lengths, delimiter=",", header="c1,c5,c3,c7", comments="")
    np.testing.assert_array_equal(path_poses(ARM, str(tmp_path / "trajectory.npz"), 100).cable_lengths, lengths)
    found = path_poses(ARM, str(tmp_path / "named.csv"), 100).cable_lengths
    np.testing.assert_allclose(found, lengths, atol=1e-15)
    thinned = path_poses(ARM, str(tmp_path / "trajectory.npz"), 3)
    np.testing.assert_array_equal(thinned.cable_lengths, lengths[[0, 8, 15]])
    np.testing.assert_allclose(thinned.nominal_pose, POSES.nominal_pose[[0, 8, 15]], atol=1e-12)


@pytest.mark.slow
def test_positions_alone_leave_the_orientation_free(tmp_path):
    np.savetxt(tmp_path / "points.csv", POINTS, delimiter=",", header="x,y,z", comments="")
    write_arrays(tmp_path / "points.npz", {"position": POINTS})
    by_name = path_poses(ARM, str(tmp_path / "points.csv"), 100)
    np.testing.assert_array_equal(
        by_name.cable_lengths, path_poses(ARM, str(tmp_path / "points.npz"), 100).cable_lengths
    )
    for point in POINTS:  # the curve meets the file's points, up to the waypoints' spacing
        assert np.linalg.norm(by_name.nominal_pose[:, :3] - point, axis=1).min() < 1.1e-3
    np.testing.assert_allclose(by_name.nominal_pose[[0, -1], :3], POINTS[[0, -1]], atol=1e-5)


@pytest.mark.slow
def test_poses_are_met_in_every_form(tmp_path):
    arm = arm_named("qj_2222")
    position = np.linspace([-0.01, 0.0, 0.44], [0.01, 0.0, 0.44], 3)
    turn = Rotation.from_rotvec(np.radians([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [4.0, 0.0, 0.0]]))
    quaternion, matrix = turn.as_quat(scalar_first=True), turn.as_matrix()
    pose = np.concatenate([position, matrix[:, :, 0], matrix[:, :, 1]], axis=1)
    write_arrays(tmp_path / "quaternion.npz", {"position": position, "quaternion": quaternion})
    write_arrays(tmp_path / "pose.npz", {"pose": pose})
    for name, columns, table in [
        ("quaternion.csv", "x,y,z,qw,qx,qy,qz", np.hstack([position, quaternion])),
        ("columns.csv", "x,y,z,xx,xy,xz,yx,yy,yz", pose),
    ]:
        np.savetxt(tmp_path / name, table, delimiter=",", header=columns, comments="", fmt="%.17g")
    for name in ("quaternion.npz", "pose.npz", "quaternion.csv", "columns.csv"):
        found = path_poses(arm, str(tmp_path / name), 100)
        assert len(found) > 10
        np.testing.assert_allclose(found.nominal_pose[[0, -1]], pose[[0, -1]], atol=1e-5)
        assert len(path_poses(arm, str(tmp_path / name), 4)) == 4
    (tmp_path / "far.csv").write_text("x,y,z\n0,0,9\n0,0.1,9\n")
    with pytest.raises(
        ConfigError, match=r"^pretension\.path: .*point 1 .* is 9.001 m from the base, allowed: up to 0.48 m"
    ):
        path_poses(arm, str(tmp_path / "far.csv"), 10)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("short.csv", "0,0,0\n", "has no header, its first line is numbers, allowed: a line of names, cable_1,cable_5"),
        ("empty.csv", "", "is empty and has no header"),
        ("words.csv", "1,5,3,7\n0,0,0,0\n0,x,0,0\n", "row 1 (the first is 0), line 3, column 5: got 'x'"),
        ("ragged.csv", "1,5,3,7\n0,0,0\n", "line 2, does not hold 4 numbers but 3"),
        ("nan.csv", "1,5,3,7\n0,0,0,0\n0,nan,0,0\n", "row 1 (the first is 0), line 3, column 5: got nan"),
        ("half.csv", "x,y,z,qw\n0,0,0.2,1\n", "columns x,y,z,qw, allowed: x,y,z [m], alone or with qw,qx,qy,qz"),
        ("point.csv", "x,y,z\n0,0,0.2\n", "holds 1 points, allowed: at least 2"),
        ("missing.npz", None, "does not exist"),
        ("missing.csv", None, "cannot be read"),
        ("path.txt", "0,0,0,0\n", "allowed: a file that ends in .csv or .npz"),
    ],
)
def test_a_path_that_cannot_be_used_is_refused_in_one_line(tmp_path, name, text, said):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=r"^pretension\.path: ") as error:
        path_poses(ARM, str(tmp_path / name), 10)
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"cable_lengths": np.zeros((5, 8))}, "holds cable_lengths (5, 8), allowed: cable_lengths (n, 4)"),
        ({"points": np.zeros((5, 3))}, "holds points (5, 3), allowed: cable_lengths (n, 4), or position (n, 3)"),
        ({"position": np.zeros((5, 2))}, "holds position (5, 2), allowed: position (n, 3)"),
        ({"cable_lengths": np.full((5, 4), np.inf)}, "cable_lengths, row 0 (the first is 0), column cable_1: got inf"),
    ],
)
def test_arrays_that_are_no_path_are_refused_in_one_line(tmp_path, arrays, said):
    write_arrays(tmp_path / "path.npz", arrays)
    with pytest.raises(ConfigError, match=r"^pretension\.path: ") as error:
        path_poses(ARM, str(tmp_path / "path.npz"), 10)
    assert said in str(error.value)
