"""One place reads a data set: it names what is wrong with it, and nothing is chosen blindly."""

import numpy as np
import pytest
from arms import arm_named

from qjrl.artifacts import ArtifactError
from qjrl.robot.model_fitting import settled_split
from qjrl.robot.settled_rows import settled_rows

ARM = arm_named("qj_22")


def data_of(count: int, random) -> dict[str, np.ndarray]:
    shapes = {"cable_lengths": (4,), "pose": (9,), "bends": (2, 2), "strand_tension": (8,)}
    data = {name: random.normal(size=(count, *shape)) for name, shape in shapes.items()}
    return data | {"converged": np.ones(count, bool), "seed": np.zeros(count, int)}


def test_a_value_that_is_not_finite_is_refused_where_its_row_counts_and_named():
    random = np.random.default_rng(0)
    for _ in range(100):
        data = data_of(20, random)
        name = random.choice(["cable_lengths", "pose", "bends", "strand_tension"])
        row = int(random.integers(20))
        data[name][row].reshape(-1)[random.integers(data[name][row].size)] = random.choice([np.nan, np.inf, -np.inf])
        with pytest.raises(ArtifactError, match=rf"^sample: row {row} \(the first is 0\) .* of {name} ") as error:
            settled_split(ARM, data, 0.1, 0)
        assert "\n" not in str(error.value)
        data["converged"][row] = False  # it did not rest: what it holds counts for nothing
        assert len(settled_rows(ARM, data)["seed"]) == 19


@pytest.mark.parametrize(("count", "resting"), [(0, 0), (16, 0), (16, 1)])
def test_too_few_rows_at_rest_are_one_line(count, resting):
    data = data_of(count, np.random.default_rng(0))
    data["converged"][resting:] = False
    with pytest.raises(ArtifactError, match=rf"^sample: {resting} of the {count} rows .* stages=\[describe\]"):
        settled_split(ARM, data, 0.1, 0)


def test_columns_that_are_missing_or_of_another_kind_are_one_line():
    data = data_of(8, np.random.default_rng(0))
    for name in data:
        with pytest.raises(ArtifactError, match=f"has no {name}"):
            settled_rows(ARM, {other: column for other, column in data.items() if other != name})
    for column in (np.zeros((7, 9)), np.zeros(8), np.zeros((8, 3)), np.zeros((8, 9), complex)):
        with pytest.raises(ArtifactError, match="pose of its data set"):
            settled_rows(ARM, data | {"pose": column})
