import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sharded_update import updated

from qjrl.artifacts import load
from qjrl.learning.ppo.mesh import device_mesh

FOLDER = Path(__file__).parent
TOLERANCE = 2e-5  # float32 sums in another order, then eight steps of Adam
TRAINED = 2e-3  # ... and some hundreds of them


def start(script, *arguments, devices=1):
    root = FOLDER.parents[2]
    paths = os.pathsep.join(map(str, (root, FOLDER)))
    flags = f"--xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"PYTHONPATH": paths, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": "1"}
    return subprocess.Popen([sys.executable, str(FOLDER / script), *map(str, arguments)], env=environment, cwd=root)


def start_both(script, *arguments):
    """Processes 0 and 1 of two, with their arguments."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    return [start(script, *own, address, process) for process, own in enumerate(arguments)]


def assert_equal_to_one_device(path):
    expected, found = updated(), load(path)
    assert found.keys() == expected.keys()
    for name, leaf in expected.items():
        np.testing.assert_allclose(found[name], leaf, rtol=TOLERANCE, atol=TOLERANCE)


def test_an_update_on_a_mesh_of_one_device_is_that_without_a_mesh_bit_for_bit():
    mesh = device_mesh()
    assert mesh.size == 1
    plain, on_mesh = updated(), updated(mesh)
    assert plain.keys() == on_mesh.keys()
    for name, leaf in plain.items():
        np.testing.assert_array_equal(on_mesh[name], leaf)


@pytest.mark.slow
def test_an_update_on_two_devices_equals_that_on_one(tmp_path):
    assert start("sharded_update.py", tmp_path / "two.npz", devices=2).wait(300) == 0
    assert_equal_to_one_device(tmp_path / "two.npz")


@pytest.mark.slow
def test_two_processes_with_half_of_the_envs_each_learn_what_one_does(tmp_path):
    both = start_both("sharded_update.py", [tmp_path / "0.npz"], [tmp_path / "1.npz"])
    assert [process.wait(300) for process in both] == [0, 0]
    for process in (0, 1):
        assert_equal_to_one_device(tmp_path / f"{process}.npz")


def start_training(out, broken_share=0.0, devices=1):
    return start("shared_training.py", out, broken_share, devices=devices)


def start_training_by_two(out, broken_share=0.0):
    return start_both("shared_training.py", [out, broken_share], [out, broken_share])


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A whole training on one device, in a process alone."""
    out = tmp_path_factory.mktemp("alone")
    assert start_training(out).wait(300) == 0
    return out


def policy_in(out, process=0):
    arrays = load(out / f"policy-{process}.npz")
    return [arrays[str(index)] for index in range(len(arrays))]


def records_in(out):
    return [
        {key: value for key, value in record.items() if key in ("iteration", "env_steps", "invalid", "reward")}
        for record in load(out / "training" / "progress.jsonl")
    ]


def assert_trained_alike(out, alone, process=0):
    for found, expected in zip(policy_in(out, process), policy_in(alone), strict=True):
        np.testing.assert_allclose(found, expected, rtol=TRAINED, atol=TRAINED)
    assert not (out / "other").exists()  # the other process writes nothing
    assert len(records_in(out)) == len(records_in(alone))
    for found, expected in zip(records_in(out), records_in(alone), strict=True):
        assert found == pytest.approx(expected, rel=TRAINED)


@pytest.mark.slow
def test_a_training_on_two_devices_is_that_on_one(alone, tmp_path):
    assert start_training(tmp_path, devices=2).wait(300) == 0
    assert_trained_alike(tmp_path, alone)


@pytest.mark.slow
def test_two_processes_train_what_one_does_and_both_get_the_policy(alone, tmp_path):
    both = start_training_by_two(tmp_path)
    assert [process.wait(300) for process in both] == [0, 0]
    for process in (0, 1):
        assert_trained_alike(tmp_path, alone, process)


@pytest.mark.slow
@pytest.mark.parametrize("goes_on", ["both", "one"])
def test_two_killed_processes_go_on_and_so_does_one_alone(alone, tmp_path, goes_on):
    both = start_training_by_two(tmp_path)
    log = tmp_path / "training" / "progress.jsonl"
    while not log.exists() or log.read_bytes().count(b"\n") < 3:  # in the midst of it
        assert both[0].poll() is None
        time.sleep(0.01)
    for process in both:
        process.kill()
        process.wait()
    again = start_training_by_two(tmp_path) if goes_on == "both" else [start_training(tmp_path)]
    assert [process.wait(300) for process in again] == [0] * len(again)
    assert_trained_alike(tmp_path, alone)


@pytest.mark.slow
@pytest.mark.parametrize("devices", [2, "two processes"])
def test_what_diverged_on_several_devices_is_what_diverges_on_one(tmp_path, devices):
    alone, out = tmp_path / "alone", tmp_path / "shared"
    several = start_training_by_two(out, 0.4) if devices == "two processes" else [start_training(out, 0.4, devices)]
    assert [process.wait(300) for process in (*several, start_training(alone, 0.4))] == [3] * (len(several) + 1)
    expected, found = (load(directory / "training" / "diverged.npz") for directory in (alone, out))
    assert len(expected["env"]) and found.keys() == expected.keys()
    for name, rows in expected.items():
        np.testing.assert_allclose(found[name], rows, rtol=TOLERANCE, atol=TOLERANCE)
