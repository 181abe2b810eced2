"""The whole controller in files: the same commands as the package's over whole episodes, or it is not written."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from controllers import ARM, CONFIG, FILES, PERIOD, STEPS, deployed, exported, live, policy, rehearsal, targets

from qjrl.artifacts import ArtifactError
from qjrl.control import controller
from qjrl.control.deployable import checked_policy
from qjrl.deployment import onnx_controller, onnx_model
from qjrl.deployment.controller import deployed_controller
from qjrl.deployment.controller_parity import FileController, check_controller
from qjrl.deployment.parity import ParityError
from qjrl.robot import cable_strokes


def test_a_prepared_controller_that_senses_its_first_reading_is_one_that_starts_with_it():
    target, lengths = (jnp.asarray(rows[0]) for rows in targets())
    reading = jnp.asarray(rehearsal().reading[0, 0])
    config = CONFIG.controller
    task = jax.jit(controller.task_of, static_argnums=0)(config, ARM, target, lengths)
    both = jax.jit(
        lambda reading: (
            controller.sense(config, ARM, controller.prepare(config, ARM, target, lengths, reading), reading),
            controller.start(config, ARM, controller.begin(config, ARM, task), reading),
        )
    )
    for one, other in zip(*map(jax.tree.leaves, both(reading)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)


def test_commands_keep_to_the_speed_and_the_strokes_and_the_whole_controller_works():
    commands = np.concatenate([np.zeros((2, 1, ARM.num_cables)), rehearsal().command], axis=1)
    assert np.abs(np.diff(commands, axis=1)).max() <= float(ARM.motor_speed) * PERIOD * (1 + 1e-9)
    assert np.all(np.abs(commands) <= np.asarray(cable_strokes(ARM)))
    assert np.abs(commands[:, -1] - targets()[1]).max() > 1e-5  # feedback and residual have moved it


def test_the_stablehlo_controller_is_the_packages_over_whole_episodes():
    report = exported().parity["control_step.stablehlo"]
    assert report["episodes"] == 2 and report["steps"] == STEPS
    assert 0.0 < report["command_difference"] < 1e-6
    modules = [jax.export.deserialize(bytearray(content)) for content in exported().files.values()]
    assert all(set(module.platforms) == {"cpu", "cuda"} for module in modules)
    assert not any("xf64" in module.mlir_module() for module in modules)


def test_files_that_command_something_else_are_refused():
    class Shifted(FileController):
        def __init__(self):
            pass

        def begin(self, target, base_lengths, reading):
            self._inner = exported().controllers["control_step.stablehlo"]
            return self._inner.begin(target, base_lengths, reading)

        def step(self, reading):
            return self._inner.step(reading) + 2e-5

    with pytest.raises(ParityError, match=r"step: commands differ by 2\S+ m, allowed: 1e-05; nothing was written"):
        check_controller("step", Shifted(), rehearsal(), FILES.parity)
    with pytest.raises(ParityError, match="commands differ by nan"):
        check_controller("step", exported().controllers["control_step.stablehlo"], spoilt(), FILES.parity)


def spoilt():
    """A rehearsal in which a reading is not a number."""
    reading = rehearsal().reading.copy()
    reading[1, 7, 0, 0] = np.nan
    return dataclasses.replace(rehearsal(), reading=reading)


def test_the_ports_are_named_in_order_and_have_units():
    step = deployed().step
    names = [port.name for port in step.inputs]
    assert names[:3] == ["target", "base_lengths", "correction"] and names[-1] == "reading"
    assert [port.name for port in step.outputs] == [f"next_{name}" for name in deployed().carried] + ["motor_angles"]
    assert all(port.unit and port.meaning for port in (*step.inputs, *step.outputs, *deployed().begin.inputs))


def test_a_state_that_is_not_described_is_refused():
    more = lambda *task: live().begin(*task) | {"more": task[0]}  # noqa: E731
    with pytest.raises(ValueError, match=r"state: got .*more"):
        deployed_controller(ARM, more, live().step, "float64")


def test_motor_angles_are_the_command_on_the_pulley():
    files = exported().controllers["control_step.stablehlo"]
    files.begin(targets()[0][0], targets()[1][0], rehearsal().reading[0, 0])
    arrays = files._state | {"reading": rehearsal().reading[0, :1].astype(np.float32)}
    answer = files._step(*(arrays[port.name] for port in deployed().step.inputs))
    radius = ARM.config.motors.pulley_radius
    np.testing.assert_allclose(answer["motor_angles"], np.asarray(answer["next_command"]) / radius, rtol=1e-6)


def test_a_policy_of_other_sizes_is_one_line():
    assert checked_policy(CONFIG.controller, ARM, policy()) is policy()
    short = dataclasses.replace(policy(), mean=policy().mean[:-1])
    with pytest.raises(ArtifactError, match=r"policy: sees \d+ numbers .* run stages=\[policy,deploy\]"):
        checked_policy(CONFIG.controller, ARM, short)


@pytest.mark.slow
@pytest.mark.skipif(bool(onnx_model.missing_packages()), reason="needs the extra onnx, which dev includes")
def test_the_onnx_controller_is_the_packages_over_whole_episodes():
    begin, step = (
        onnx_controller.load(onnx_controller.onnx_bytes(one, "float32")) for one in (deployed().begin, deployed().step)
    )
    files = FileController(deployed(), begin, step, "float32", is_batched=False)
    assert check_controller("onnx", files, rehearsal(), 1e-5)["command_difference"] < 1e-6
