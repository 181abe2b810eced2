"""All default stages on the two-segment arm at the smallest size, then again, then with one value changed."""

import dataclasses
import html
import logging
import shutil

import numpy as np
import pytest
from customary import customary_ppo

from qjrl import artifacts, pipeline
from qjrl.artifacts import ArtifactError
from qjrl.config import as_mapping, conf_folder, read_yaml
from qjrl.control.episode import EnvironmentConfig
from qjrl.control.inversion import IKConfig
from qjrl.control.policy_training import PolicyConfig
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.fitting import FitConfig
from qjrl.learning.networks import NetworkConfig
from qjrl.pipeline import STAGES
from qjrl.report.output import write_output
from qjrl.robot import load_robot, robot_hash
from qjrl.robot.forward_model import ForwardModelConfig, load_forward_model
from qjrl.simulation import SettleConfig
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.sampling import SampleConfig
from qjrl.solvers import AdamConfig, FabrikConfig, LeastSquaresConfig
from qjrl.solvers.least_squares import RoundConfig
from qjrl.studies.accuracy import stage as accuracy
from qjrl.studies.accuracy.feasibility import UnreachableConfig
from qjrl.studies.accuracy.measure import AccuracyConfig
from qjrl.studies.open_loop import stage as open_loop
from qjrl.studies.open_loop.measure import OpenLoopConfig

DEFAULT = [name for name, stage in STAGES.items() if stage.default]
CONTROLLERS = {
    "nominal", "learned_ik", "learned_ik+integral", "learned_ik+dither",
    "learned_ik+dither+estimate", "learned_ik+dither+integral",
    "learned_ik+dither+estimate+residual",
}  # fmt: skip
CONFIGS = {
    "simulation": SettleConfig(batch_size=32),
    "engine": EngineConfig(),
    "sample": SampleConfig(num_samples=40, shard_size=16),
    "forward_model": ForwardModelConfig(
        "corrected", NetworkConfig(16, 1, 1, zero_output=True), FitConfig(epochs=4, batch_size=16, evaluate_every=2)
    ),
    "ik": IKConfig(
        least_squares=LeastSquaresConfig(num_candidates=128, batch_size=16),
        num_held_out=4,
        num_bank=6,
    ),
    "policy": PolicyConfig(
        num_envs=8,
        num_evaluated=1,
        environment=EnvironmentConfig(episode_steps=150, latest_arrival=2.8, scored_time=0.1),
        ppo=customary_ppo(num_steps=64, unroll_length=4, num_epochs=1, num_minibatches=2, checkpoint_every=1),
    ),
}


def tree(**changes):
    """The resolved configuration, as the command would compose it."""
    parts = {name: as_mapping(changes.get(name, config)) for name, config in CONFIGS.items()}
    robot = read_yaml(conf_folder() / "robot" / "qj_22.yaml")
    return {"name": "tiny", "seed": 0, "stages": DEFAULT, "robot": robot, **parts}


def run(run_dir, stages=None, **changes):
    wanted = tree(**changes) | ({"stages": stages} if stages else {})
    pipeline.run(pipeline.selected(wanted), pipeline.build_configs(wanted), run_dir)


def stages_run(caplog):
    """Which stages ran and which were skipped, from the log."""
    lines = [record.getMessage() for record in caplog.records if record.name == "qjrl.stage"]
    skipped = {line.split(":")[0] for line in lines if "skipped" in line}
    return [line.split(":")[0] for line in lines if "starts" in line], skipped


@pytest.fixture(scope="module", autouse=True)
def _default_stages_alone():
    """Stages on demand need keys of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "STAGES", {name: STAGES[name] for name in DEFAULT})
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    run_dir = tmp_path_factory.mktemp("run")
    run(run_dir)
    return run_dir


@pytest.fixture
def run_dir(finished, tmp_path):
    """A copy of the finished run, to be changed."""
    return shutil.copytree(finished, tmp_path / "copy")


def test_every_stage_writes_what_it_promises(finished):
    expected = {
        "dataset": ["manifest.json", "shard-00000.npz", "shard-00002.npz"],
        "forward_model": ["model.npz", "model.json", "metrics.json", "progress.jsonl", "checkpoints"],
        "ik": ["held_out.npz", "bank.npz", "metrics.json"],
        "policy": ["policy.npz", "policy.json", "metrics.json", "progress.jsonl", "checkpoints"],
        "compare": ["outcomes.npz", "metrics.json", "report.html"],
    }
    assert {STAGES[name].writes for name in DEFAULT} == expected.keys()
    for directory, names in expected.items():
        for name in [*names, "done.json", "provenance.json"]:
            assert (finished / directory / name).exists(), f"{directory}/{name}"
        assert artifacts.load(finished / directory / "provenance.json")["seed"] == 0
    assert not [path for path in finished.rglob("*") if path.suffix in (".pkl", ".pickle", ".tmp")]


def test_the_dataset_and_the_model_belong_to_the_robot(finished):
    robot = load_robot("qj_22")
    data = artifacts.load(finished / "dataset", robot_hash(robot))
    assert len(data["seed"]) == 40 and data["converged"].mean() > 0.9
    metrics = artifacts.load(finished / "forward_model" / "metrics.json")
    assert metrics["rows"]["fitted"] + metrics["rows"]["held_out"] == data["converged"].sum()
    assert load_forward_model(finished / "forward_model" / "model", robot).config == CONFIGS["forward_model"]


def test_answers_are_settled_and_both_errors_are_reported(finished):
    answers = artifacts.load(finished / "ik" / "held_out.npz")
    assert answers["target_set"].tolist() == [0] * 4 + [1] * 4
    for controller in ("nominal", "learned"):
        found = np.linalg.norm(answers[f"{controller}_pose"][:, :3] - answers["target"][:, :3], axis=1)
        settled = answers[f"{controller}_settled"]
        np.testing.assert_allclose(answers[f"{controller}_position_error"][settled], found[settled], atol=1e-12)
    metrics = artifacts.load(finished / "ik" / "metrics.json")
    assert metrics["real"].keys() == metrics["predicted"].keys() == set(TARGET_SETS)
    for index, target_set in enumerate(TARGET_SETS):
        assert sum(metrics["predicted"][target_set]["statuses"].values()) == 4
        slack = answers["least_tension"][answers["target_set"] == index] < 0.01
        assert metrics["predicted"][target_set]["slack_share"] == slack.mean()
    bank = artifacts.load(finished / "ik" / "bank.npz")
    assert len(bank["target"]) == 12
    distances = np.linalg.norm(bank["target"][:, None] - answers["target"][None], axis=2)
    assert distances.min() > 0  # nothing the policy trains on is held out


def test_the_policys_metrics_say_what_was_trained(finished):
    metrics = artifacts.load(finished / "policy" / "metrics.json")
    assert metrics["env_steps"] == 64 and metrics["invalid_steps"] == 0
    assert metrics["physics_steps_per_second"] > 0 and set(metrics["num_left_out"]) == set(TARGET_SETS)


def test_every_controller_is_compared_on_both_sets(finished):
    metrics = artifacts.load(finished / "compare" / "metrics.json")
    assert metrics["controllers"].keys() == set(TARGET_SETS)
    for controllers in metrics["controllers"].values():
        assert controllers.keys() == CONTROLLERS
    assert html.escape(metrics["headline"]) in (finished / "compare" / "report.html").read_text()
    outcomes = artifacts.load(finished / "compare" / "outcomes.npz")
    for target_set in TARGET_SETS:
        sizes = {len(outcomes[f"{target_set}/{controller}/position_error"]) for controller in CONTROLLERS}
        assert len(sizes) == 1 and sizes.pop() <= 4


def test_a_second_run_skips_everything(finished, caplog):
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*") if path.is_file() and path.name != ".lock"}
    with caplog.at_level(logging.INFO):
        run(finished)
    assert stages_run(caplog) == ([], set(DEFAULT))
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_another_name_of_the_run_only_writes_the_report_again(run_dir, caplog):
    changed = tree() | {"name": "other"}
    with caplog.at_level(logging.INFO):
        pipeline.run(pipeline.selected(changed), pipeline.build_configs(changed), run_dir)
    assert stages_run(caplog) == (["compare"], {"sample", "forward_model", "ik", "policy"})
    assert "run other" in (run_dir / "compare" / "report.html").read_text()


@pytest.mark.slow
def test_a_changed_solver_runs_again_what_depends_on_it_alone(run_dir, caplog):
    adam = AdamConfig(iterations=30, num_restarts=2, num_candidates=128, num_retries=0, batch_size=8)
    changed = dataclasses.replace(CONFIGS["ik"], method="adam", adam=adam)
    with caplog.at_level(logging.INFO):
        run(run_dir, ["sample", "forward_model", "ik"], ik=changed)
    assert stages_run(caplog) == (["ik"], {"sample", "forward_model"})
    old, new = (artifacts.load(run_dir / name / "held_out.npz") for name in ("ik.previous", "ik"))
    np.testing.assert_array_equal(old["target"], new["target"])
    assert not np.array_equal(old["learned_lengths"], new["learned_lengths"])


def test_an_interrupted_sampling_goes_on_and_equals_the_uninterrupted_one(finished, tmp_path, monkeypatch, caplog):
    from qjrl.simulation import sampling

    real = sampling.append_shard

    def append_and_stop(*arguments, **about):
        real(*arguments, **about)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(sampling, "append_shard", append_and_stop)
        run(tmp_path, ["sample"])
    with caplog.at_level(logging.INFO):
        run(tmp_path, ["sample"])
    assert "sample: was interrupted, goes on" in caplog.text
    one, other = artifacts.load(tmp_path / "dataset"), artifacts.load(finished / "dataset")
    for name in other:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    hashes = [artifacts.load(path / "dataset" / artifacts.DONE)["output_hash"] for path in (tmp_path, finished)]
    assert hashes[0] == hashes[1]


def test_a_dataset_of_another_robot_is_refused_in_one_line(run_dir):
    other = tree() | {"robot": read_yaml(conf_folder() / "robot" / "qj_2222.yaml"), "stages": ["forward_model"]}
    with pytest.raises(ArtifactError, match="belongs to another robot; run stages="):
        pipeline.run(pipeline.selected(other), pipeline.build_configs(other), run_dir)


@pytest.mark.slow
def test_open_loop_settles_what_every_method_commands(finished, tmp_path):
    config = open_loop.Config(
        read_yaml(conf_folder() / "robot" / "qj_22.yaml"),
        CONFIGS["simulation"],
        CONFIGS["ik"],
        OpenLoopConfig(num_targets=5, fabrik=FabrikConfig(outer_iterations=20, batch_size=16)),
        seed=0,
    )
    write_output(open_loop.run(config, {"forward_model": finished / "forward_model"}, tmp_path), tmp_path)
    metrics, raw = artifacts.load(tmp_path / "metrics.json"), artifacts.load(tmp_path / "outcomes.npz")
    for target_set in TARGET_SETS:
        assert metrics["controllers"][target_set].keys() == {"fabrik", "least_squares", "learned_ik"}
        errors = {
            name: raw[f"{target_set}/{name}/position_error"][raw[f"{target_set}/{name}/settled"]]
            for name in ("fabrik", "learned_ik")
        }
        ratio = np.median(errors["fabrik"]) / np.median(errors["learned_ik"])
        assert metrics["ratios"][target_set]["fabrik"] == pytest.approx(ratio)
        assert (tmp_path / f"{target_set}.png").stat().st_size > 10_000


@pytest.mark.slow
def test_accuracy_evaluates_every_controller_on_the_same_targets(finished, tmp_path):
    config = accuracy.Config(
        read_yaml(conf_folder() / "robot" / "qj_22.yaml"),
        CONFIGS["simulation"],
        CONFIGS["ik"],
        AccuracyConfig(
            num_targets=6,
            measurements=1,
            fabrik=FabrikConfig(outer_iterations=20, batch_size=16),
            unreachable=UnreachableConfig(num_targets=3, thorough=RoundConfig(8, 20)),
        ),
        seed=0,
    )
    inputs = {"sample": finished / "dataset", "forward_model": finished / "forward_model"}
    write_output(accuracy.run(config, inputs, tmp_path), tmp_path)
    metrics = artifacts.load(tmp_path / "metrics.json")
    for number in ("after_0", "after_1"):
        assert metrics["exact"][number].keys() == {"fabrik", "least_squares", "learned_ik"}
    for name in metrics["solved_share"]:
        exact, noisy = (artifacts.load(tmp_path / f"{kind}-{name}.npz") for kind in ("exact", "noisy"))
        np.testing.assert_array_equal(exact["position_error"][0], noisy["position_error"][0])
        median = 1e3 * np.nanmedian(exact["position_error"][1])
        assert metrics["exact"]["after_1"][name]["position_median_mm"] == pytest.approx(median)
    open_loop_median, corrected = (
        metrics["exact"][number]["least_squares"]["position_median_mm"] for number in ("after_0", "after_1")
    )
    assert corrected < 0.1 * open_loop_median
    assert (tmp_path / "corrections.png").stat().st_size > 10_000
    assert all(sum(counts.values()) == 6 for counts in metrics["statuses"].values())
    assert metrics["unreachable"]["far"]["statuses"] == {"nearest": 3}
    assert metrics["tension"]["any"]["tension_error_max_N"] < 0.1
    before = (tmp_path / "metrics.json").read_bytes()
    (tmp_path / "noisy-learned_ik.npz").unlink()
    write_output(accuracy.run(config, inputs, tmp_path), tmp_path)
    assert (tmp_path / "metrics.json").read_bytes() == before  # what was interrupted goes on to the same end
