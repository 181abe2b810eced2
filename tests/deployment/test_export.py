"""Files that run without the package: they compute the same, at any batch size, or they are not written."""

import dataclasses
import json
import logging
import re
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from deployable import ARM, CONFIG, HASH, make_run, run_export, untrained_model
from settled import settled_rows

from qjrl import artifacts
from qjrl.artifacts import ArtifactError, hash_of_file
from qjrl.config import ConfigError
from qjrl.deployment import export as deployment_export
from qjrl.deployment import onnx_model, stablehlo
from qjrl.deployment.export import ExportConfig, export_controller, held_out_rows
from qjrl.deployment.parity import ParityError, check_inverse, make_reference
from qjrl.geometry.pose import orientation_error, position_error
from qjrl.robot import bends_from_cables
from qjrl.robot.forward_model import pose_function
from qjrl.robot.model_fitting import split_rows
from qjrl.stages import export as export_stage

pytestmark = pytest.mark.skipif(bool(onnx_model.missing_packages()), reason="needs the extra onnx, which dev includes")
ROOT = Path(__file__).parent.parent.parent
MODEL = untrained_model()
LIVE = pose_function(ARM, MODEL)
COMPILED = jax.jit(jax.vmap(LIVE))


def staying_home(model):
    """The cheapest honest solver: it never moves."""
    pose = pose_function(ARM, model)

    def solve(target):
        lengths = jnp.zeros(ARM.num_cables, target.dtype)
        reached = pose(lengths).astype(target.dtype)
        position, orientation = position_error(reached, target), orientation_error(reached, target)
        return {
            "cable_lengths": lengths,
            "position_error": position,
            "orientation_error": orientation,
            "converged": position < 1e-3,
        }

    return solve


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run"), MODEL)


@pytest.fixture(scope="module")
def exported(run_dir):
    """The whole export, with ONNX."""
    return run_export(run_dir, onnx=True)


@pytest.fixture(scope="module")
def contract(exported):
    return artifacts.load(exported / "contract.json")


def live_poses(lengths):
    """At up to 7 rows: one compilation for all tests."""
    return np.asarray(COMPILED(np.resize(lengths, (7, ARM.num_cables)).astype(np.float64)))[: len(lengths)]


@pytest.mark.parametrize("file", ["forward_model.stablehlo", "forward_model.onnx"])
@pytest.mark.parametrize("batch", [1, 7])
def test_the_forward_model_in_a_file_is_the_live_one_at_any_batch_size(exported, file, batch):
    module = onnx_model if file.endswith("onnx") else stablehlo
    lengths = settled_rows(32)["cable_lengths"][:batch]
    poses = np.asarray(module.load((exported / file).read_bytes())(lengths.astype(np.float32))["pose"])
    assert poses.shape == (batch, 9) and poses.dtype == np.float32
    np.testing.assert_allclose(poses, live_poses(lengths), atol=3e-6)


@pytest.mark.parametrize("batch", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_the_inverse_in_a_file_reaches_its_targets_and_flags_what_it_cannot(exported, batch):
    call = stablehlo.load((exported / "inverse_kinematics.stablehlo").read_bytes())
    targets = np.array(live_poses(0.3 * settled_rows(32)["cable_lengths"][:batch]))
    targets[5:, 0] += 1.0  # a metre away
    answer = {name: np.asarray(array) for name, array in call(targets.astype(np.float32)).items()}
    distance = np.linalg.norm(live_poses(answer["cable_lengths"])[:, :3] - targets[:, :3], axis=1)
    np.testing.assert_allclose(answer["position_error"], distance, atol=2e-6)
    assert answer["converged"].tolist() == [True, True, True, True, True, False, False][:batch]
    assert distance[answer["converged"]].max() < CONFIG.ik.descent.position_tolerance


def test_files_run_on_both_platforms_in_one_precision_and_name_no_folder(exported):
    for path in exported.glob("*.stablehlo"):
        content = path.read_bytes()
        module = jax.export.deserialize(bytearray(content))
        assert set(module.platforms) == {"cpu", "cuda"}
        assert not re.search(r"\dxf64", module.mlir_module())  # scalar constants may be of any type
        assert str(ROOT).encode() not in content
    assert str(ROOT).encode() not in (exported / "forward_model.onnx").read_bytes()


def test_the_contract_says_all_that_a_controller_needs(exported, contract):
    assert contract["robot"]["hash"] == HASH and contract["precision"] == "float32"
    assert contract["versions"]["jax"] == jax.__version__ and "jax2onnx" in contract["versions"]
    assert contract["config_hash"] == artifacts.load(exported / "provenance.json")["config_hash"]
    assert [port["name"] for port in contract["functions"]["inverse_kinematics"]["outputs"]] == [
        "cable_lengths", "position_error", "orientation_error", "converged",
    ]  # fmt: skip
    assert [cable["name"] for cable in contract["cables"]] == [
        name for pair in ARM.config.cables.names for name in pair
    ]
    for function in contract["functions"].values():
        assert all(port["unit"] and port["shape"][0] == "batch" for port in function["inputs"] + function["outputs"])
        for name, about in function["files"].items():
            assert about["sha256"] == hash_of_file(exported / name)
    motors = contract["motors"]
    assert motors["largest_torque"]["value"] == pytest.approx(245.0 * 0.020)  # paper 000, section 5.1: 4.9 N m
    assert motors["largest_angular_speed"]["value"] == pytest.approx(15 * 2 * np.pi / 60, rel=1e-3)  # and 15 rpm
    assert contract["homing"]["pretension"]["unit"] == "N" and motors["sign"]


def test_the_contracts_map_to_bends_is_the_arms(contract):
    lengths = settled_rows(32)["cable_lengths"][0]
    bends = np.asarray(bends_from_cables(ARM, jnp.asarray(lengths))).reshape(-1)
    np.testing.assert_allclose(np.array(contract["bends"]["from_cable_lengths"]) @ lengths, bends, atol=1e-14)
    assert contract["bends"]["limit"] == pytest.approx(np.sin(np.radians(35.0)))


def test_parity_and_accuracy_are_reported_for_every_file(exported, contract):
    metrics = artifacts.load(exported / "metrics.json")
    assert set(metrics["parity"]) == {name for one in contract["functions"].values() for name in one["files"]}
    for file in ("forward_model.stablehlo", "forward_model.onnx"):
        assert metrics["parity"][file]["random"]["rows"] == 32
        assert 0.0 < metrics["parity"][file]["held_out"]["position_difference"] < 3e-6
    assert metrics["latency"].keys() == metrics["parity"].keys()
    assert all(0.0 < one["median_ms"] <= one["p99_ms"] for one in metrics["latency"].values())
    assert metrics["accuracy"]["held_out_rows"] == metrics["parity"]["forward_model.onnx"]["held_out"]["rows"]


def test_held_out_rows_are_those_that_the_fit_did_not_see(run_dir):
    rows = settled_rows(32)
    settled = rows["seed"][rows["converged"]]
    _, expected = split_rows(len(settled), 0.25, seed=0)
    found = held_out_rows(ARM, run_dir / "dataset", run_dir / "forward_model", MODEL.config)
    np.testing.assert_array_equal(found["seed"], settled[expected])


@pytest.mark.parametrize("script", ["run_stablehlo.py", "run_onnx.py"])
def test_an_example_runs_where_there_is_no_qjrl(exported, tmp_path, script):
    path = ROOT / "experiments" / "export" / script
    assert len(path.read_text().splitlines()) <= 30
    program = "import runpy, sys; sys.modules['qjrl'] = None; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0])"
    command = [sys.executable, "-I", "-c", program, str(path), str(exported)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("tip at") == 7


def test_a_file_that_computes_something_else_is_not_written(run_dir, tmp_path, monkeypatch):
    copy = shutil.copytree(run_dir, tmp_path / "run", ignore=shutil.ignore_patterns("export"))
    honest = stablehlo.serialise

    def shifted(deployed, precision, platforms):
        wrong = lambda row: {name: value + 1e-4 for name, value in deployed.function(row).items()}  # noqa: E731
        is_forward = deployed.name == "forward_model"
        return honest(dataclasses.replace(deployed, function=wrong) if is_forward else deployed, precision, platforms)

    monkeypatch.setattr(stablehlo, "serialise", shifted)
    monkeypatch.setattr(deployment_export, "compact_ik", lambda *_: staying_home(MODEL))
    with pytest.raises(ParityError, match=r"forward_model.stablehlo: random rows: position .* allowed: 1e-05"):
        run_export(copy)
    assert [path.name for path in (copy / "export").iterdir()] == ["provenance.json"]


def test_any_solver_can_be_exported_and_without_the_extra_one_line_says_what_is_missing(monkeypatch, caplog):
    monkeypatch.setattr(onnx_model, "missing_packages", lambda: ["jax2onnx"])
    wanted = dataclasses.replace(CONFIG, onnx=True)
    with caplog.at_level(logging.WARNING, "qjrl"):
        export = export_controller(ARM, MODEL, wanted, settled_rows(32), 0, solve=staying_home(MODEL))
    (line,) = [record.getMessage() for record in caplog.records if record.name.startswith("qjrl")]
    assert "jax2onnx is not installed: pip install 'qjrl[onnx]'" in line
    assert set(export.files) == {"forward_model.stablehlo", "inverse_kinematics.stablehlo"}
    assert export_stage.Config({}, wanted, seed=0).packages == {
        "missing for ONNX": "jax2onnx"
    }  # installed, it runs again
    assert export_stage.Config({}, CONFIG, seed=0).packages == {}
    monkeypatch.undo()
    assert export_stage.Config({}, wanted, seed=0).packages == {}
    assert export.metrics["parity"]["inverse_kinematics.stablehlo"]["random"]["same_answer_share"] == 1.0


def test_an_inverse_that_lies_bends_too_far_or_solves_less_is_refused():
    reference = make_reference(ARM, LIVE, settled_rows(32), "float32", CONFIG.parity, 0)
    honest = jax.jit(jax.vmap(staying_home(MODEL)))(reference.targets.astype(np.float32))
    check_inverse("file", lambda _: honest, lambda _: honest, reference)
    for wrong, words in (
        ({"position_error": 0.99 * honest["position_error"]}, "random targets: stated position error"),
        ({"orientation_error": jnp.full(len(reference.targets), jnp.nan)}, "stated orientation error differ by nan"),
        ({"cable_lengths": honest["cable_lengths"] + 0.1}, "bend and its limit"),
    ):
        with pytest.raises(ParityError, match=words):
            check_inverse("file", lambda _, wrong=wrong: honest | wrong, lambda _: honest, reference)
    solves = honest | {"converged": jnp.ones(len(reference.targets), bool)}
    with pytest.raises(ParityError, match=r"100\.0% in the package"):
        check_inverse("file", lambda _: honest, lambda _: solves, reference)


def test_double_precision_in_onnx_is_refused():
    with pytest.raises(ConfigError, match="precision: got float64 with onnx true, allowed: float32, or"):
        ExportConfig(precision="float64", onnx=True)


@pytest.mark.slow
def test_the_papers_form_in_double_precision_is_exact():
    wanted = dataclasses.replace(CONFIG, precision="float64", platforms=("cpu",), onnx=False)
    model = untrained_model("paper")
    export = export_controller(ARM, model, wanted, settled_rows(32), 0, solve=staying_home(model))
    assert export.metrics["parity"]["forward_model.stablehlo"]["random"]["position_difference"] < 1e-9


def test_a_model_of_another_data_set_has_no_held_out_rows(run_dir, tmp_path):
    copy = shutil.copytree(run_dir, tmp_path / "run", ignore=shutil.ignore_patterns("export"))
    artifacts.append_shard(copy / "dataset", settled_rows(32), HASH)
    artifacts.mark_done(copy / "dataset", robot_hash=HASH)
    with pytest.raises(ArtifactError, match=r"was fitted to another data set .* run stages=\[forward_model,export\]"):
        run_export(copy)


def test_an_unfinished_or_foreign_model_is_one_line(run_dir, tmp_path):
    copy = shutil.copytree(run_dir, tmp_path / "run", ignore=shutil.ignore_patterns("export"))
    marker = copy / "forward_model" / "done.json"
    marker.write_text(json.dumps(json.loads(marker.read_text()) | {"robot_hash": "another"}))
    with pytest.raises(ArtifactError, match=r"belongs to another robot; run stages=\[forward_model,export\]"):
        run_export(copy)
    marker.unlink()
    with pytest.raises(ArtifactError, match=r"is not finished; run stages=\[forward_model,export\]"):
        run_export(copy)
