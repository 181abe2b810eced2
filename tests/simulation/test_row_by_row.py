import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from arms import arm_named

from qjrl.simulation import row_by_row as module
from qjrl.simulation.row_by_row import BLOCK, row_by_row

ARM = arm_named("qj_22")
ROWS = np.random.default_rng(0).normal(size=(BLOCK + 3, 4))

# A second CPU device stands for the accelerator.
ON_TWO_DEVICES = """
import jax
import numpy as np
from qjrl.robot import load_robot
from qjrl.simulation import row_by_row as module

seen, block = [], module._block
module._block = lambda *arguments: (seen.append(block(*arguments)), seen[-1])[1]
with jax.default_device(jax.devices()[1]):
    robot = jax.tree.map(jax.numpy.asarray, load_robot("qj_22"))
    module.row_by_row(lambda robot, row: row * robot.bend_limit, robot, np.ones((3, 4)))
print(robot.link_length.devices(), seen[0].devices())
"""


def _sine(robot, row):
    del robot
    return jax.numpy.sin(row), jax.numpy.sum(row)


def test_a_row_has_the_same_bits_alone_and_among_others() -> None:
    together, alone = row_by_row(_sine, ARM, ROWS), row_by_row(_sine, ARM, ROWS[-1:])
    assert [part.shape for part in together] == [(BLOCK + 3, 4), (BLOCK + 3,)]
    for many, one in zip(together, alone, strict=True):
        np.testing.assert_array_equal(many[-1:], one)
    assert [part.shape for part in row_by_row(_sine, ARM, ROWS[:0])] == [(0, 4), (0,)]


def test_it_is_done_on_the_cpu_beside_an_accelerator() -> None:
    root = Path(__file__).parents[2]
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "PYTHONPATH": str(root)}
    said = subprocess.run([sys.executable, "-c", ON_TWO_DEVICES], env=environment, capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    assert said.stdout.split() == ["{CpuDevice(id=1)}", "{CpuDevice(id=0)}"]


def test_without_a_cpu_backend_the_default_device_does(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_):
        raise RuntimeError("Unknown backend cpu")

    monkeypatch.setattr(jax, "local_devices", refuse)
    assert module._host() is None
    np.testing.assert_array_equal(row_by_row(_sine, ARM, ROWS)[1].shape, (BLOCK + 3,))
