import dataclasses

import mujoco
import numpy as np
import pytest
from arms import arm_named

from qjrl.robot import build_mjcf
from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.simulation.payload import tip_body

PAYLOADS = np.array([0.0, 0.05, 0.3])


def with_payload(arm: QuaternionArm, payload: float) -> QuaternionArm:
    return dataclasses.replace(arm, payload=payload)


def compiled(arm: QuaternionArm) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(build_mjcf(arm))


def tensor(model: mujoco.MjModel, inertia: np.ndarray) -> np.ndarray:
    """Of the last body, in its own axes."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[-1])
    rotation = axes.reshape(3, 3)
    return rotation @ np.diag(inertia) @ rotation.T


@pytest.mark.parametrize("name", ["qj_22", "rolling_312"])  # described without a payload, and with one
def test_the_last_body_is_the_one_that_mujoco_compiles_with_that_payload(name):
    arm = arm_named(name)
    model = compiled(arm)
    found = tip_body(arm, model, PAYLOADS)
    for index, payload in enumerate(PAYLOADS):
        expected = compiled(with_payload(arm, payload))
        np.testing.assert_allclose(found.mass[index], expected.body_mass[-1], rtol=1e-12)
        np.testing.assert_allclose(found.centre[index], expected.body_ipos[-1], atol=1e-12)
        moments = tensor(model, found.inertia[index]), tensor(expected, expected.body_inertia[-1])
        np.testing.assert_allclose(*moments, atol=1e-12)


def test_the_described_payload_changes_no_bit():
    arm = arm_named("rolling_312")
    model = compiled(arm)
    same = tip_body(arm, model, np.array([arm.config.mechanics.payload]))
    np.testing.assert_array_equal(same.mass[0], model.body_mass[-1])
    np.testing.assert_array_equal(same.centre[0], model.body_ipos[-1])
    np.testing.assert_array_equal(same.inertia[0], model.body_inertia[-1])
