import dataclasses

import numpy as np
import pytest

from qjrl.report.tables import as_markdown
from qjrl.studies.accuracy.corrections import (
    MEDIAN_OF_THREE_NORMALS,
    corrections_metrics,
    corrections_table,
    noise_floor,
    ratios,
)
from qjrl.studies.accuracy.figures import errors_by_measurements


@dataclasses.dataclass(frozen=True)
class Errors:
    position_error: np.ndarray
    orientation_error: np.ndarray


LEARNED = np.array([[1e-4, 2e-4, 3e-4, np.nan], [1e-6, 2e-6, 3e-6, 4e-6]])
FABRIK = np.array([[1e-1, 2e-4, 3e-1, 4e-1], [1e-6, 4e-6, 5e-6, np.nan]])
RUNS = {"fabrik": Errors(FABRIK, np.radians(FABRIK)), "learned_ik": Errors(LEARNED, np.radians(LEARNED))}
SOLVED = {"fabrik": np.array([False, True, False, False]), "learned_ik": np.ones(4, bool)}


def test_medians_are_those_of_what_settled_and_the_rest_is_counted():
    learned = corrections_metrics(RUNS)["after_0"]["learned_ik"]
    assert learned["num_unsettled"] == 1
    assert learned["position_median_mm"] == pytest.approx(0.2) and learned["orientation_median_deg"] == pytest.approx(
        2e-4
    )


def test_ratios_compare_at_equally_many_measurements_and_on_what_was_solved():
    found = ratios(RUNS, SOLVED)
    assert found["after_0"]["fabrik"]["ratio"] == pytest.approx(0.1 / 2e-4)  # three targets settled for both
    assert found["after_0"]["fabrik"]["orders_of_magnitude"] == pytest.approx(np.log10(500.0))
    assert found["after_0"]["fabrik"]["ratio_where_it_solves"] == pytest.approx(1.0)
    assert found["after_1"]["fabrik"]["ratio"] == pytest.approx(2.0)


def test_the_floor_of_noise_is_the_median_length_of_three_normal_numbers():
    drawn = np.linalg.norm(np.random.default_rng(0).normal(size=(100_000, 3)), axis=1)
    assert pytest.approx(np.median(drawn), rel=0.01) == MEDIAN_OF_THREE_NORMALS
    assert noise_floor(1e-4, 0.0)["position_median_mm"] == pytest.approx(0.1 * MEDIAN_OF_THREE_NORMALS)


def test_the_table_and_the_figure_hold_every_run():
    table = corrections_table({"exact": corrections_metrics(RUNS)})
    assert [row[:3] for row in table.rows] == [
        ("exact", "FABRIK", 0), ("exact", "FABRIK", 1), ("exact", "learned IK", 0), ("exact", "learned IK", 1),
    ]  # fmt: skip
    lines = as_markdown(table).splitlines()
    assert len(lines) == 6 and all(line.count("|") == len(table.columns) + 1 for line in lines)
    positions = {name: one.position_error for name, one in RUNS.items()}
    figure = errors_by_measurements({"exact": (positions, None), "noisy": (positions, 1e-4)})
    assert [len(axes.lines) for axes in figure.axes] == [2, 3]
