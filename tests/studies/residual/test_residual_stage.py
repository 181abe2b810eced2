"""Stage `residual` on the two-segment arm, with episodes of half a second and a policy that does nothing.

Two arms and banks of two targets everywhere, so that every function is compiled for one shape.
"""

import dataclasses

import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends
from customary import customary_ppo
from idle import idle_policy

from qjrl import artifacts
from qjrl.config import conf_folder, read_yaml
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.policy_training import PolicyConfig
from qjrl.control.randomisation import RandomisationConfig
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.policy import save_policy
from qjrl.report.output import write_output
from qjrl.robot import cable_lengths, forward_kinematics
from qjrl.simulation.engine import EngineConfig
from qjrl.studies.residual import measure as study
from qjrl.studies.residual import stage as residual
from qjrl.studies.residual.measure import ResidualStudyConfig, ablate, effects, errors_of, make_subject
from qjrl.studies.residual.parameter_effects import NOMINAL

pytestmark = pytest.mark.slow

ARM = arm_named("qj_22")
BASE, POLICY = "learned_ik", "learned_ik+residual"
VARIED = ("strand_friction", "gain_scale", "encoder_noise_deg")
STANDSTILL = 1e-30
"""A rate of learning at which PPO moves nothing."""
GAIN = EnvironmentConfig().integral.gain
SETTINGS = ResidualStudyConfig(num_targets=1, baseline_gains=(0.5 * GAIN, GAIN), share=0.5, ablations=("as it is",))
CONFIG = PolicyConfig(
    base="learned",
    num_envs=2,
    num_evaluated=1,
    environment=EnvironmentConfig(
        episode_steps=24,
        latest_arrival=0.4,
        scored_time=0.06,
        randomisation=dataclasses.replace(NOMINAL, **{name: getattr(RandomisationConfig(), name) for name in VARIED}),
    ),
    ppo=customary_ppo(
        num_steps=32,
        unroll_length=8,
        num_epochs=1,
        num_minibatches=2,
        learning_rate=STANDSTILL,
        min_learning_rate=STANDSTILL,
        max_learning_rate=STANDSTILL,
        actor_layers=(16,),
        critic_layers=(16,),
    ),
)


def targets(seed):
    """Columns of a target bank, near enough to be reached in time."""
    bends = random_bends(ARM, 4, seed, 0.15)
    poses, lengths = (over_rows(verb, ARM, bends) for verb in (forward_kinematics, cable_lengths))
    return {"target_set": np.repeat([0, 1], 2), "target": poses, "nominal_lengths": lengths, "learned_lengths": lengths}


HELD_OUT, BANK = targets(0), targets(1)


def subject(seed=0):
    return make_subject(ARM, EngineConfig(), CONFIG, HELD_OUT, SETTINGS.num_targets, seed)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    for name, columns in (("held_out", HELD_OUT), ("bank", BANK)):
        artifacts.write_arrays(folder / "ik" / f"{name}.npz", columns)
    (folder / "policy").mkdir()
    save_policy(folder / "policy" / "policy", idle_policy(ARM, CONFIG.environment))
    robot = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    config = residual.Config(robot, EngineConfig(), CONFIG, SETTINGS, seed=0)
    inputs = {"ik": folder / "ik", "policy": folder / "policy"}
    write_output(residual.run(config, inputs, folder / "residual"), folder / "residual")
    return folder / "residual"


def test_it_writes_traces_numbers_a_table_and_figures(finished):
    traces, metrics = artifacts.load(finished / "traces.npz"), artifacts.load(finished / "metrics.json")
    controllers = {BASE, POLICY, "learned_ik+integral", "learned_ik+dither"}
    assert traces.keys() == controllers | {"floor", "target_set"}
    assert {traces[name].shape for name in controllers | {"floor"}} == {(24, 2)}
    assert metrics["effects"].keys() == {"nothing", *VARIED, "all"}
    assert metrics["ablations"].keys() == {"as it is"}
    table = (finished / "table.md").read_text()
    for name in (*metrics["effects"], "as it is"):
        assert name.replace("_", " ") in table
    for name in TARGET_SETS:
        assert (finished / f"errors_{name}.png").stat().st_size > 10_000


def test_a_policy_that_does_nothing_is_its_base_bit_for_bit(finished):
    traces = artifacts.load(finished / "traces.npz")
    np.testing.assert_array_equal(traces[POLICY], traces[BASE])
    assert np.isfinite(traces[BASE]).all()
    assert not np.array_equal(traces[BASE], traces["learned_ik+dither"])


def test_the_encoders_have_a_floor_from_arrival_on(finished):
    floor, metrics = artifacts.load(finished / "traces.npz")["floor"], artifacts.load(finished / "metrics.json")
    assert np.isnan(floor[0]).all() and (floor[-1] > 0).all()
    has_arrived = np.isfinite(floor)
    assert (np.diff(has_arrived.astype(int), axis=0) >= 0).all()
    for index, name in enumerate(TARGET_SETS):
        expected = 1e3 * np.median(floor[-CONFIG.environment.scored_steps :, index])
        assert metrics["floor_mm"][name] == pytest.approx(expected)


def test_with_nothing_varied_the_error_is_that_without_randomisation(finished):
    found = artifacts.load(finished / "metrics.json")["effects"]
    still = dataclasses.replace(CONFIG.environment, randomisation=NOMINAL)
    for seed in (0, 1):  # no arm is drawn, so that the seed does not matter
        nominal = subject(seed).evaluate(still, "learned")
        assert errors_of(nominal, subject().targets["target_set"]) == found["nothing"]
    assert found["encoder_noise_deg"] == found["nothing"]  # without feedback nobody reads them
    for name in ("strand_friction", "gain_scale", "all"):
        assert found[name] != found["nothing"]
    assert effects(subject(1), lambda: None)["all"] != found["all"]


def test_the_baseline_is_evaluated_with_every_gain(finished):
    traces, found = artifacts.load(finished / "traces.npz"), artifacts.load(finished / "metrics.json")["baseline"]
    assert list(found) == [str(0.5 * GAIN), str(GAIN)]
    scored = 1e3 * traces["learned_ik+integral"][-CONFIG.environment.scored_steps :].mean(axis=0)
    assert found[str(GAIN)]["uniform_median_mm"] == pytest.approx(scored[0])  # the default gain is the baseline's own
    assert found[str(0.5 * GAIN)] != found[str(GAIN)]


def test_an_ablation_that_has_learnt_nothing_is_its_base_and_is_trained_once(finished, monkeypatch):
    found = artifacts.load(finished / "metrics.json")["ablations"]
    assert found["as it is"]["policy"] == found["as it is"]["base"]
    records = artifacts.load(finished / "ablations" / "as_it_is" / "progress.jsonl")
    assert records[-1]["env_steps"] == 16  # its share

    def refuse(*_):
        raise AssertionError("trained again")

    monkeypatch.setattr(study, "train_policy", refuse)
    assert ablate(subject(), BANK, SETTINGS, finished / "ablations", lambda: None) == found
    with pytest.raises(AssertionError, match="trained again"):
        ablate(subject(1), BANK, SETTINGS, finished / "ablations", lambda: None)
