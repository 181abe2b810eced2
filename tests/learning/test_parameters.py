import numpy as np
import pytest

from qjrl.artifacts import ArtifactError, load
from qjrl.learning.parameters import load_parameters, save_parameters

TREE = {"dense": {"kernel": np.arange(6, dtype=np.float32).reshape(2, 3), "bias": np.zeros(3)}, "count": np.int32(7)}


def test_parameters_come_back_as_they_were(tmp_path):
    save_parameters(tmp_path / "model", TREE, {"width": 3})
    tree, description = load_parameters(tmp_path / "model")
    assert description == {"width": 3}
    assert tree["count"] == 7
    assert np.array_equal(tree["dense"]["kernel"], TREE["dense"]["kernel"])
    assert tree["dense"]["kernel"].dtype == np.float32


def test_names_are_joined_by_a_slash(tmp_path):
    save_parameters(tmp_path / "model", TREE, {})
    assert sorted(load(tmp_path / "model.npz")) == ["count", "dense/bias", "dense/kernel"]


def test_missing_parameters_are_one_clear_line(tmp_path):
    with pytest.raises(ArtifactError, match=r"model\.npz: does not exist"):
        load_parameters(tmp_path / "model")
