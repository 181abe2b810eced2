"""The stage on the two-segment arm, in its own equations; slow, as every disturbance compiles its draws."""

import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends
from idle import idle_policy

from qjrl import artifacts
from qjrl.config import conf_folder, read_yaml
from qjrl.control.bases import controller_name
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.policy_training import PolicyConfig
from qjrl.learning.ppo.policy import save_policy
from qjrl.report.output import write_output
from qjrl.robot import cable_lengths, forward_kinematics
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.studies.robustness import stage
from qjrl.studies.robustness.measure import UNDISTURBED, RobustnessConfig

pytestmark = pytest.mark.slow

ARM, COUNT = arm_named("qj_22"), 6
POLICY = PolicyConfig(environment=EnvironmentConfig(episode_steps=120, latest_arrival=1.5, scored_time=0.2))


def of_controllers(columns, disturbance):
    """Position errors on the uniform set under a disturbance."""
    names = {base: controller_name(base) for base in ("learned", POLICY.base)}
    names["policy"] = controller_name(POLICY.base, has_policy=True)
    return {key: columns[f"{disturbance}/uniform/{name}/position_error"] for key, name in names.items()}


def test_every_disturbance_moves_the_errors_and_an_idle_policy_equals_its_base(tmp_path):
    bends = random_bends(ARM, COUNT, share=0.4)
    targets, lengths = over_rows(forward_kinematics, ARM, bends), over_rows(cable_lengths, ARM, bends)
    (tmp_path / "ik").mkdir()
    held_out = {
        "target": targets,
        "target_set": np.repeat([0, 1], COUNT // 2),
        "nominal_lengths": lengths,
        "learned_lengths": lengths,
    }
    artifacts.write_arrays(tmp_path / "ik" / "held_out.npz", held_out)
    (tmp_path / "policy").mkdir()
    save_policy(tmp_path / "policy" / "policy", idle_policy(ARM, POLICY.environment))
    out = tmp_path / "out"
    robot = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    settings = RobustnessConfig(num_targets=COUNT // 2, bases=("learned",), engine="training")
    inputs = {"ik": tmp_path / "ik", "policy": tmp_path / "policy"}
    config = stage.Config(robot, SettleConfig(), EngineConfig(), POLICY, settings, seed=0)
    write_output(stage.run(config, inputs, out), out)
    metrics = artifacts.load(out / "metrics.json")
    assert metrics["exceptions"] == [] and len(metrics["disturbances"]) == 9
    columns = artifacts.load(out / "outcomes.npz")
    for disturbance in metrics["disturbances"]:
        errors = of_controllers(columns, disturbance)
        np.testing.assert_array_equal(errors[POLICY.base], errors["policy"])
        undisturbed = of_controllers(columns, UNDISTURBED)
        if disturbance in (UNDISTURBED, "one dead encoder"):  # the plain base asks no encoder
            np.testing.assert_array_equal(errors["learned"], undisturbed["learned"])
        if disturbance != UNDISTURBED:
            # A plain arm that arrives 40 ms late rests where it would have.
            watched = POLICY.base if disturbance in ("one dead encoder", "40 ms delay") else "learned"
            assert np.any(errors[watched] != undisturbed[watched]), disturbance
    for name in ("uniform.png", "near_home.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    assert "one dead encoder" in (out / "table.md").read_text()
