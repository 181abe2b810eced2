"""What cannot change a row settles no data set again, and all else does."""

from typing import Any

import pytest

from qjrl import artifacts, pipeline
from qjrl.config import conf_folder, identity_of, read_yaml

ROBOT = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
OTHER_ROBOT = ROBOT | {"link_length": 0.031}
SAMPLE, SIMULATION = {"num_samples": 6, "shard_size": 4}, {"num_threads": 2, "batch_size": 4}


def run(run_dir, **changes: Any) -> None:
    tree = {"robot": ROBOT, "sample": SAMPLE, "simulation": SIMULATION, "seed": 3, "stages": ["sample"]} | changes
    pipeline.run(["sample"], pipeline.build_configs(tree, ["sample"]), run_dir)


@pytest.fixture(scope="module")
def settled(tmp_path_factory):
    run_dir = tmp_path_factory.mktemp("settled")
    run(run_dir)
    return run_dir


@pytest.mark.parametrize(
    "change",
    [
        {"simulation": SIMULATION | {"num_threads": 1}},
        {"simulation": SIMULATION | {"num_threads": 0, "batch_size": 1}},
        {"sample": SAMPLE | {"shard_size": 1}},
        {"sample": SAMPLE | {"num_shards": 3}},
    ],
    ids=str,
)
def test_threads_batch_shards_and_parts_change_no_bit_and_settle_nothing_again(
    settled, tmp_path, caplog, change
) -> None:
    with caplog.at_level("INFO", "qjrl.stage"):
        run(settled, **change)
    assert [record.getMessage() for record in caplog.records if record.name == "qjrl.stage"] == [
        "sample: done before and unchanged, skipped"
    ]
    run(tmp_path, **change)
    one, other = artifacts.load(settled / "dataset"), artifacts.load(tmp_path / "dataset")
    assert one.keys() == other.keys()
    for name, column in one.items():
        assert column.tobytes() == other[name].tobytes(), name


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 4},
        {"robot": OTHER_ROBOT},
        {"sample": SAMPLE | {"num_samples": 5}},
        {"sample": SAMPLE | {"home_share": 0.5}},
        *(
            {"simulation": SIMULATION | {key: value}}
            for key, value in {
                "backend": "mjx",
                "timestep": 0.002,
                "speed_tolerance": 1e-3,
                "hold_time": 0.1,
                "max_time": 20.0,
                "damping_scale": 1.0,
            }.items()
        ),
    ],
    ids=str,
)
def test_all_else_belongs_to_the_identity(change) -> None:
    def identity(**changes: Any) -> str:
        tree = {"robot": ROBOT, "sample": SAMPLE, "simulation": SIMULATION, "seed": 3} | changes
        config = pipeline.build_configs(tree, ["sample"])["sample"]
        return artifacts.hash_of(identity_of(config.whole()))

    assert identity(**change) != identity()
