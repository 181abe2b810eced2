import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sharded_update import updated

from qjrl.artifacts import load

SCRIPT = Path(__file__).with_name("sharded_update.py")
TOLERANCE = 2e-5  # float32 sums in another order, then eight steps of Adam


def start(*arguments, devices=1):
    root = SCRIPT.parents[3]
    paths = os.pathsep.join(map(str, (root, SCRIPT.parent)))
    flags = f"--xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"PYTHONPATH": paths, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": "1"}
    return subprocess.Popen([sys.executable, str(SCRIPT), *map(str, arguments)], env=environment, cwd=root)


def assert_equal_to_one_device(path):
    expected, found = updated(is_sharded=False), load(path)
    assert found.keys() == expected.keys()
    for name, leaf in expected.items():
        np.testing.assert_allclose(found[name], leaf, rtol=TOLERANCE, atol=TOLERANCE)


def test_an_update_on_one_device_is_the_same_whether_it_is_sharded_or_not():
    plain, sharded = updated(is_sharded=False), updated(is_sharded=True)
    for name, leaf in plain.items():
        np.testing.assert_array_equal(sharded[name], leaf)


@pytest.mark.slow
def test_an_update_on_two_devices_equals_that_on_one(tmp_path):
    assert start(tmp_path / "two.npz", devices=2).wait(300) == 0
    assert_equal_to_one_device(tmp_path / "two.npz")


@pytest.mark.slow
def test_two_processes_with_half_of_the_environments_each_learn_what_one_does(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    both = [start(tmp_path / f"{process}.npz", address, process) for process in (0, 1)]
    assert [process.wait(300) for process in both] == [0, 0]
    for process in (0, 1):
        assert_equal_to_one_device(tmp_path / f"{process}.npz")
