"""Tables by name: whatever the order, the same numbers; whatever is wrong with one, one line that says where."""

import csv
import io
import pickle
import zipfile

import numpy as np
import pytest
from arms import arm_named
from scipy.spatial.transform import Rotation

from qjrl.config import ConfigError
from qjrl.control.path.files import ALLOWED_COLUMNS, POSE_LAYOUTS, read_points
from qjrl.control.tension.path import cable_quantity, read_path
from qjrl.robot import cable_strokes
from qjrl.table_file import read_table

ARM = arm_named("qj_22")
NAMES = cable_quantity(ARM).columns
STROKES = np.asarray(cable_strokes(ARM))
CASES = 600


def text_of(header, rows, ending="\n"):
    out = io.StringIO()
    csv.writer(out, lineterminator=ending).writerows([header, *[[repr(float(cell)) for cell in row] for row in rows]])
    return out.getvalue()


def refused(call, *words):
    with pytest.raises(ConfigError) as error:
        call()
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message


@pytest.fixture
def random():
    return np.random.default_rng(0)


def test_permuted_columns_in_every_spelling_are_exactly_the_same_numbers(tmp_path, random):
    spellings = ["cable_{}", "{}", "c{}", "Cable_{}", "cable_{} [m]", "cable_{} (m)", "cable_{}_m", " cable_{} "]
    for case in range(CASES // 3):
        lengths = STROKES * random.uniform(-1.0, 1.0, (random.integers(1, 6), 4))
        order, spelling = random.permutation(4), spellings[random.integers(len(spellings))]
        header = [spelling.format(NAMES[place].split("_")[1]) for place in order]
        ending, mark = ("\n", "\r\n")[case % 2], ("", "﻿", "# ")[case % 3]
        file = tmp_path / "lengths.csv"
        file.write_bytes((mark + text_of(header, lengths[:, order], ending)).encode())
        np.testing.assert_array_equal(read_path(ARM, str(file)), lengths)
        names = np.array([NAMES[place] for place in order])
        np.savez(tmp_path / "lengths.npz", cable_lengths=lengths[:, order], cable_names=names, time=np.zeros(1))
        np.testing.assert_array_equal(read_path(ARM, str(tmp_path / "lengths.npz")), lengths)


def test_points_in_any_order_of_columns_are_the_same_points(tmp_path, random):
    for _ in range(CASES // 6):
        values = np.column_stack([0.1 * random.uniform(0.1, 1.0, (4, 3)), random.normal(size=(4, 4))])
        values[:, 3:] /= np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
        names, order = ["x", "y", "z", "qw", "qx", "qy", "qz"], random.permutation(7)
        file = tmp_path / "points.csv"
        file.write_text(text_of([names[place] for place in order], values[:, order]))
        found = read_table(file, POSE_LAYOUTS, ALLOWED_COLUMNS)
        np.testing.assert_array_equal(found["position"], values[:, :3])
        np.testing.assert_array_equal(found["quaternion"], values[:, 3:])


def test_one_fault_anywhere_in_a_csv_is_one_line_that_names_the_place(tmp_path, random):
    for _ in range(CASES // 2):
        rows = [[f"{cell:.6f}" for cell in row] for row in STROKES * random.uniform(-0.5, 0.5, (5, 4))]
        header, words = list(NAMES), []
        row, column = random.integers(5), random.integers(4)
        fault = random.choice(
            ["cell", "nan", "short", "long", "twice", "missing", "extra", "unit", "mm", "comma", "none"]
        )
        place = f"row {row} (the first is 0), line {row + 2}"
        if fault in ("cell", "nan", "comma"):
            bad = {"cell": ["x", "", "1_0", "0x1", "1.0D-3", "--1"], "nan": ["nan", "-INF", "1e999"], "comma": ["0,01"]}
            rows[row][column] = str(random.choice(bad[fault]))
            words = [place, f"column {NAMES[column]}", "decimal comma" if fault == "comma" else "got"]
        elif fault in ("short", "long"):
            rows[row] = rows[row][:-1] if fault == "short" else rows[row] * 2
            words = [place, "does not hold 4 numbers"]
        elif fault == "twice":
            header[column] = NAMES[(column + 1) % 4]
            words = [f"{NAMES[(column + 1) % 4]} 2 times"]
        elif fault == "missing":
            header.pop(column)
            rows = [[*row[:column], *row[column + 1 :]] for row in rows]
            words = [f"{NAMES[column]} missing"]
        elif fault == "extra":
            header.append("cable_2")
            rows = [[*row, "0"] for row in rows]
            words = ["cable_2 too much"]
        elif fault == "unit":
            header[column] += str(random.choice(["_mm", " [mm]", " (mm)", "[mm]", " mm"]))
            words = [f"'{header[column]}' is in mm", "divide by 1,000"]
        elif fault == "mm":
            rows[row][column] = f"{1000 * STROKES[column] * random.uniform(0.1, 1.0):.6f}"
            words = [f"row {row} ", NAMES[column], "in millimetres? divide by 1,000"]
        else:
            header, words = rows.pop(0), ["has no header, its first line is numbers"]
        out = io.StringIO()
        csv.writer(out).writerows([header, *rows])
        (tmp_path / "bad.csv").write_text(out.getvalue())
        refused(lambda: read_path(ARM, str(tmp_path / "bad.csv")), "pretension.path: ", "bad.csv: ", *words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "x,y,z\n" + "0.03,0,0.215,0.015,0,0.215\n" * 2,
            "row 0 (the first is 0), line 2, does not hold 3 numbers but 6",
        ),
        ("x;y;z\n0,03;0;0,2\n0;0;0,2\n", "separated by ';'"),
        ("x\ty\tz\n0\t0\t0.2\n", "separated by tabulators"),
        ("x,y,z\n0,03,0,01,0,2\n", "decimal commas?"),
        ("x,y,z\n", "no rows below it"),
        ("\n\n", "is empty"),
        ("x_mm,y_mm,z_mm\n1,2,3\n", "'x_mm' is in mm"),
        ("x,y,z,qx,qy,qz\n0,0,0.2,0,0,0\n", "qw missing"),
        ("x,y,z\n50,0,200\n49,0,200\n", "point 0 (the first is 0) is 206.2 m from the base"),
        ("x,y,z,qx,qy,qz,qw\n0,0,0.2,0,0,0,1\n0,0,0.21,0,0,0,2\n", "point 1 (the first is 0) is no unit quaternion"),
    ],
)
def test_tables_of_points_that_are_none(tmp_path, text, words):
    (tmp_path / "points.csv").write_text(text)
    refused(lambda: read_points(tmp_path / "points.csv", ARM), words)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"position": np.zeros((4, 6))}, "position (4, 6)"),
        ({"pose": np.zeros((4, 3))}, "pose (4, 3)"),
        ({"position": np.zeros(12)}, "position (12,)"),
        ({"position": np.zeros((3, 3), complex)}, "complex128"),
        ({"position": np.zeros((3, 3), bool)}, "bool"),
        ({"position": np.full((3, 3), "a")}, "real numbers"),
        ({"position": np.array([[None] * 3])}, "Python objects"),
        ({"position": np.zeros((0, 3))}, "no rows"),
        ({"position": np.zeros((3, 3)), "quaternion": np.zeros((2, 4))}, "as many"),
        ({"position": np.zeros((3, 3)), "pose": np.zeros((3, 9))}, "allowed: position (n, 3), or"),
        ({"position": np.array([[0, 0, 0.2], [0, np.nan, 0.2]])}, "row 1 (the first is 0), column y"),
    ],
)
def test_arrays_of_another_kind_are_one_line(tmp_path, arrays, words):
    np.savez(tmp_path / "points.npz", **arrays)
    refused(lambda: read_points(tmp_path / "points.npz", ARM), "points.npz", words)


def test_whole_numbers_are_numbers(tmp_path):
    np.savez(tmp_path / "points.npz", position=np.array([[0, 0, 0], [0, 0, 1]], np.int16))
    np.testing.assert_array_equal(read_points(tmp_path / "points.npz").position, [[0, 0, 0], [0, 0, 1]])


# --- files of other programs ------------------------------------------------------------------------------------------

POINTS = "0,0,0.2\n0.01,0,0.2\n"


@pytest.mark.parametrize(
    "text",
    [
        "# exported 2024-05-01 by a tool\nx,y,z\n" + POINTS,
        "# exported\n# frame: base, unit: m\n# x,y,z\n" + POINTS,
        "sep=,\nx [m],y [m],z [m]\n" + POINTS,
        "# x,y,z\n" + POINTS,
        '"x","y","z"\n' + POINTS,
    ],
    ids=range(5),
)
def test_what_other_programs_write_above_the_names_is_let_be(tmp_path, text) -> None:
    (tmp_path / "a.csv").write_text(text)
    found = read_table(tmp_path / "a.csv", POSE_LAYOUTS, ALLOWED_COLUMNS)
    np.testing.assert_array_equal(found["position"], [[0, 0, 0.2], [0.01, 0, 0.2]])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('x,"y,z\n' + 500 * POINTS, "line 1: a quote is not closed there"),
        ("x,y,z\n" + POINTS + '0,"0,0.2\n' + POINTS, "line 4: a quote is not closed there"),
        ("x [m];y [m];z [m]\n0;0;1\n", "separated by ';'"),
        ("x [m] y [m] z [m]\n0 0 1\n", "separated by blanks"),
        (f"{'a' * 5000},y,z\n" + POINTS, "allowed: x,y,z"),
        (",".join(f"column{i}" for i in range(3000)) + "\n" + POINTS, "(3000 in all)"),
        (f"x [{'m' * 3000}],y,z\n" + POINTS, "allowed: x in m"),
        (("x,y,z\n" + POINTS).encode("utf-16"), "save it as UTF-8"),
        (("x,y,位置\n" + POINTS).encode("gbk"), "line 1 is not in UTF-8"),
    ],
    ids=range(9),
)
def test_a_file_in_another_form_is_one_short_line(tmp_path, content, words) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError) as error:
        read_table(path, POSE_LAYOUTS, ALLOWED_COLUMNS)
    message = str(error.value).removeprefix(str(tmp_path))
    assert words in message and "\n" not in message and len(message) < 900, message


def test_a_unit_is_converted_in_words_only_where_it_can_be(tmp_path) -> None:
    for unit, hint in (("mm", "divide by 1,000"), ("in", "multiply by 0.0254"), ("deg", "allowed: cable_1 in m")):
        (tmp_path / "a.csv").write_text(f"cable_1 [{unit}],5,3,7\n0,0,0,0\n")
        with pytest.raises(ConfigError, match=f"is in {unit}.*{hint}") as error:
            read_path(ARM, str(tmp_path / "a.csv"))
        assert "57.3" not in str(error.value)


def test_texts_and_pickles_in_an_npz_are_one_line(tmp_path) -> None:
    path = tmp_path / "a.npz"
    for member in ("position.npy.txt", "position"):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(member, "hello")
        with pytest.raises(ConfigError, match=r"a\.npz: ") as error:
            read_table(path, POSE_LAYOUTS, ALLOWED_COLUMNS)
        assert "allow_pickle" not in str(error.value)
    for content in (pickle.dumps([1, 2]), b"x,y,z\n1,2,3\n", b""):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=r"not a \.npz file") as error:
            read_table(path, POSE_LAYOUTS, ALLOWED_COLUMNS)
        assert "allow_pickle" not in str(error.value)


def test_what_is_no_rotation_is_refused_and_the_order_of_its_numbers_is_said(tmp_path) -> None:
    turns = Rotation.random(5, rng=np.random.default_rng(0)).as_matrix()
    position = np.column_stack([np.linspace(0.0, 0.1, 5), np.zeros(5), np.full(5, 0.1)])
    order = "of the 3 x 3 matrix the first column, then the second"
    by_columns = np.concatenate([turns[:, :, 0], turns[:, :, 1]], axis=1)
    np.savez(tmp_path / "a.npz", position=position, rotation=by_columns)
    points = read_points(tmp_path / "a.npz")
    assert points.rotation is not None
    np.testing.assert_allclose(points.rotation.as_matrix(), turns, atol=1e-12)
    for wrong in (turns, turns.reshape(5, 9), turns[:, :, :2].reshape(5, 6), 2.0 * by_columns):
        np.savez(tmp_path / "a.npz", position=position, rotation=wrong)
        with pytest.raises(ConfigError, match=order):
            read_points(tmp_path / "a.npz")
