"""The command as a user meets it: exit code, and what it says. In this process where that is enough, to save time."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from command import Command, Said, assert_one_line, run_command

from qjrl import artifacts, pipeline
from qjrl.cli.overview import overview
from qjrl.learning.divergence import TrainingDiverged
from qjrl.pipeline import STAGES
from qjrl.report.output import Output
from qjrl.stage_config import RobotStageConfig

ROOT = Path(__file__).parent.parent


@pytest.fixture
def qjrl(tmp_path, monkeypatch, capsys) -> Command:
    """The command, in an empty folder; the environment it sets is forgotten afterwards."""
    for name in ("HYDRA_FULL_ERROR", "JAX_ENABLE_X64", "JAX_COMPILATION_CACHE_DIR", "MUJOCO_GL"):
        monkeypatch.setenv(name, os.environ.get(name, ""))
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run_command(monkeypatch, capsys, *arguments)


@pytest.fixture
def two_stages(qjrl, monkeypatch) -> Command:
    """The command with two small stages in place of the real ones; they take the whole configuration as it is."""

    def count(config: Any, inputs: dict[str, Path], out: Path) -> Output:
        if config.seed == 13:
            raise RuntimeError("thirteen")
        if config.seed == 14:
            try:
                raise TrainingDiverged("iteration 14: 20.0% of the steps diverged")
            except TrainingDiverged as error:
                raise TrainingDiverged(f"{error}; states: diverged.npz") from error
        return Output({"far": {"learned": {"position_median_mm": config.seed / 2}}})

    groups = {"robot", *pipeline.GROUPS}
    fake = ModuleType("fake")
    fields = [(name, dict) for name in sorted(groups - {"robot"})]
    kind = dataclasses.make_dataclass("Config", fields, bases=(RobotStageConfig,), frozen=True)
    fake.__dict__.update(run=count, Config=kind)
    monkeypatch.setitem(sys.modules, "fake", fake)
    stages = {
        "sample": pipeline.Stage("fake", "first", writes="dataset"),
        "compare": pipeline.Stage("fake", "second", reads=("sample",), writes="compare"),
    }
    monkeypatch.setattr(pipeline, "STAGES", stages)
    monkeypatch.setattr(pipeline, "GROUPS", dict.fromkeys(pipeline.GROUPS, "sample"))
    return lambda *arguments: qjrl("stages=[sample,compare]", *arguments)


def in_a_process(program: list[str], folder: Path) -> "subprocess.Popen[str]":
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, *program],
        cwd=folder,
        env=environment,
        text=True,
        stdout=pipe,
        stderr=pipe,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # ignored in a background job
    )


def test_help_answers_at_once_with_stages_groups_and_examples(tmp_path) -> None:
    start = time.monotonic()
    with in_a_process(["-m", "qjrl", "--help"], tmp_path) as process:
        out, _ = process.communicate()
    assert time.monotonic() - start < 3.0  # under one second on an idle machine
    assert process.returncode == 0
    for word in ("sample", "describe", "qj_2222*", "+experiment", "robot=my_arm.yaml"):
        assert word in out


def test_help_shows_every_stage_once_under_the_pipeline_the_tools_or_the_studies() -> None:
    headings = ("Pipeline", "Tools", "Studies", "Groups")
    text = overview()
    starts = [text.index(f"\n{heading}") for heading in headings]
    assert starts == sorted(starts)
    shown = {
        heading: re.findall(r"^  (\w+) .*\(\w+/\)$", text[start:end], re.MULTILINE)
        for heading, start, end in zip(headings, starts, starts[1:], strict=False)
    }
    assert sorted(name for names in shown.values() for name in names) == sorted(STAGES)
    assert shown["Pipeline"] == [name for name, stage in STAGES.items() if stage.default]
    assert all(STAGES[name].module == f"qjrl.studies.{name}.stage" for name in shown["Studies"])
    assert all(STAGES[name].module == f"qjrl.stages.{name}" for name in (*shown["Pipeline"], *shown["Tools"]))


def test_help_imports_neither_jax_nor_mujoco_and_no_stage(tmp_path) -> None:
    program = "import sys; sys.argv[1:] = ['--help']; from qjrl.__main__ import main; main(); print(*sys.modules)"
    with in_a_process(["-c", program], tmp_path) as process:
        modules = set(process.communicate()[0].split())
    assert "qjrl.pipeline" in modules
    assert not modules & {"jax", "mujoco", "brax", "hydra", "matplotlib"}
    assert not [name for name in modules if name.startswith(("qjrl.stages", "qjrl.studies"))]


def test_a_mistake_in_a_process_of_its_own_is_one_line_on_stderr(tmp_path) -> None:
    with in_a_process(["-m", "qjrl", "stages=[smaple]"], tmp_path) as process:
        out, error = process.communicate()
    assert_one_line(Said(process.returncode, out, error), "stages: got 'smaple'", "did you mean 'sample'?")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["stages=[smaple]"], ["stages", "'smaple'", "did you mean 'sample'"]),
        (["stages=sample"], ["stages", "'sample'", "a list"]),
        (["seeed=3"], ["seeed", "3", "did you mean 'seed'"]),
        (["nothing.at.all=3"], ["nothing", "no such key", "seed"]),
        (["robot.joint.pin_distanc=3"], ["robot.joint.pin_distanc", "3", "did you mean 'pin_distance'"]),
        (["robot=qj_2223"], ["robot", "'qj_2223'", "did you mean 'qj_2222'"]),
        (["robot=nowhere/arm.yaml"], ["nowhere/arm.yaml", "cannot be read"]),
        (["+experiment=smok"], ["experiment", "'smok'"]),
        (["experiment=smoke"], ["+experiment=smoke"]),
        (["seed=[1"], ["seed=[1"]),
        (["nonsense"], ["nonsense"]),
        (["seed=1,2"], ["seed=1,2", "--multirun"]),
        (["-m", "seed=1,2", "seeed=1"], ["seeed", "did you mean 'seed'"]),
        (["robot=3"], ["group", "int"]),
    ],
    ids=" ".join,
)
def test_a_mistake_on_the_command_line_is_one_line_and_exit_code_2(qjrl, arguments, words) -> None:
    assert_one_line(qjrl(*arguments), *words)


@pytest.mark.parametrize("content", ["a: [1", "- 1\n- 2\n", ""])
def test_a_robot_file_that_is_not_a_mapping_is_one_line(qjrl, tmp_path, content) -> None:
    (tmp_path / "my_arm.yaml").write_text(content)
    assert_one_line(qjrl("robot=my_arm.yaml"), "my_arm.yaml")


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("+seeed=3", ["seeed: got 3", "did you mean 'seed'"]),
        ("seed=one", ["seed: got 'one'", "an integer"]),
        ("seed=1.5", ["seed: got 1.5", "an integer"]),
        ("robot.link_length=-0.03", ["robot.link_length: got -0.03", "at least 0"]),
        ("robot.joints_per_segment=[]", ["robot.joints_per_segment: got []"]),
        ("robot.joint.bend_limit_deg=90", ["robot.joint.bend_limit_deg: got 90"]),
        ("robot.cables.hole_angles_deg=[[0,90],[0,90],[22.5,112.5],[67.5,157.5]]", ["robot.cables.hole_angles_deg"]),
        ("+robot.colour=red", ["robot.colour: got 'red'", "no such key"]),
        ("robot.kind=snake", ["robot.kind: got 'snake'", "quaternion_arm"]),
    ],
)
def test_a_value_that_is_not_allowed_is_one_line_before_any_work(two_stages, tmp_path, override, words) -> None:
    assert_one_line(two_stages(override), *words)
    assert not list(tmp_path.rglob("dataset"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sample.num_samples=-3"], ["sample.num_samples: got -3", "an integer from 1 to 100000000"]),
        (["sample.num_sampels=3"], ["sample.num_sampels", "did you mean 'num_samples'"]),
        (["forward_model.network.width=wide"], ["forward_model.network.width: got 'wide'", "an integer"]),
        (["simulation.timestep=-0.1"], ["simulation.timestep: got -0.1"]),
        (["simulation=bullet"], ["simulation", "'bullet'", "mjx, mjx_warp, mujoco"]),
        (["stages=[forward_model]"], ["outputs/default/dataset", "run stages=[sample,forward_model]"]),
    ],
    ids=" ".join,
)
def test_a_mistake_about_a_stage_is_one_line_too(qjrl, tmp_path, arguments, words) -> None:
    assert_one_line(qjrl(*arguments), *words)
    assert not list(tmp_path.rglob("*.npz"))


def test_a_run_says_where_it_is_and_the_same_command_again_skips_it(two_stages, tmp_path) -> None:
    first = two_stages("name=mine")
    assert first.code == 0, first.err
    assert "outputs/mine" in first.out
    again = two_stages("name=mine")
    assert again.out.count("skipped") == 2
    summary = json.loads((tmp_path / "outputs" / "mine" / "summary.json").read_text())
    assert summary["status"] == "done"
    assert "name=mine" in summary["overrides"]


def test_a_robot_may_come_from_a_file(two_stages, tmp_path) -> None:
    text = (ROOT / "conf" / "robot" / "qj_2222.yaml").read_text()
    (tmp_path / "arms").mkdir()
    for name in ("my arm.yaml", "qj_2222.yaml"):  # a space; the name of a shipped one
        (tmp_path / "arms" / name).write_text(text.replace("link_length: 0.03", "link_length: 0.04"))
    for value in ("'arms/my arm.yaml'", "arms/qj_2222.yaml", str(tmp_path / "arms" / "qj_2222.yaml")):
        result = two_stages(f"robot={value}", "name=mine")
        assert result.code == 0, result.err
        provenance = json.loads((tmp_path / "outputs" / "mine" / "dataset" / "provenance.json").read_text())
        assert provenance["config"]["robot"]["link_length"] == 0.04
    (tmp_path / "arms" / "bad.yaml").write_text(text + "\ncolour: red\n")
    assert_one_line(two_stages("robot=arms/bad.yaml"), "robot.colour: got 'red'")


def test_a_failure_that_nobody_foresaw_keeps_its_traceback(two_stages) -> None:
    result = two_stages("seed=13")
    assert result.code == 1
    assert "RuntimeError: thirteen" in result.err


def test_a_training_that_diverged_is_one_line_and_exit_code_1(two_stages, tmp_path) -> None:
    result = two_stages("seed=14", "name=lost")
    assert result.code == 1
    assert result.err == "iteration 14: 20.0% of the steps diverged; states: diverged.npz\n"
    summary = json.loads((tmp_path / "outputs" / "lost" / "summary.json").read_text())
    assert (summary["status"], summary["error"]) == ("failed", result.err.strip())


def test_a_sweep_ends_with_one_table_and_fails_if_a_job_does(two_stages, tmp_path) -> None:
    (tmp_path / "my_arm.yaml").write_text((ROOT / "conf" / "robot" / "qj_2222.yaml").read_text())
    result = two_stages("-m", "seed=1,2", "robot=qj_2222,my_arm.yaml", "name=both")
    assert result.code == 0, result.err
    rows = json.loads((tmp_path / "outputs" / "both" / "sweep.json").read_text())
    assert [row["job"] for row in rows] == [
        f"robot={arm},seed={seed}" for arm in ("my_arm", "qj_2222") for seed in (1, 2)
    ]
    assert [row["metrics"]["compare.far.learned.position_median_mm"] for row in rows] == [0.5, 1.0, 0.5, 1.0]
    assert "robot=my_arm,seed=2" in result.out
    table = (tmp_path / "outputs" / "both" / "sweep.csv").read_text().splitlines()
    assert len(table) == 5

    result = two_stages("-m", "seed=1,13,one", "name=bad")
    assert result.code == 1
    rows = {row["job"]: row for row in json.loads((tmp_path / "outputs" / "bad" / "sweep.json").read_text())}
    assert {job: row["status"] for job, row in rows.items()} == {
        "seed=1": "done",
        "seed=13": "failed",
        "seed=one": "bad input",
    }
    assert "thirteen" in rows["seed=13"]["error"]
    assert "thirteen" in result.out


def test_a_sweep_over_shards_fills_one_data_set_and_the_rest_goes_on_from_there(qjrl, tmp_path) -> None:
    size = ("stages=[sample]", "robot=qj_22", "sample.num_samples=6", "sample.shard_size=2")
    result = qjrl("-m", *size, "sample.shard=0,1", "sample.num_shards=2", "name=shared")
    assert result.code == 0, result.err
    dataset = tmp_path / "outputs" / "shared" / "dataset"
    assert (dataset / "done.json").exists() and not dataset.with_name("dataset.parts").exists()
    rows = json.loads((tmp_path / "outputs" / "shared" / "sweep.json").read_text())
    assert [row["job"] for row in rows] == ["sample.shard=0", "sample.shard=1"]

    assert "sample: done before and unchanged, skipped" in qjrl(*size, "name=shared").out
    assert qjrl(*size, "name=alone").code == 0
    alone = artifacts.load(tmp_path / "outputs" / "alone" / "dataset")
    for name, column in artifacts.load(dataset).items():
        assert column.tobytes() == alone[name].tobytes(), name


@pytest.mark.slow
def test_shards_and_seeds_may_be_swept_together_and_a_gap_is_one_line(qjrl, tmp_path) -> None:
    size = ("stages=[sample]", "robot=qj_22", "sample.num_samples=4", "sample.shard_size=2", "name=shared")
    assert qjrl("-m", *size, "sample.num_shards=2", "sample.shard=0", "seed=1,2").code == 0
    assert qjrl("-m", *size, "seed=1,2").code == 1
    rows = json.loads((tmp_path / "outputs" / "shared" / "sweep.json").read_text())
    assert [row["status"] for row in rows] == ["bad input", "bad input"]
    assert "seed=1/dataset.parts: rows 2 to 3 of 4 are missing" in rows[0]["error"]
    assert qjrl("-m", *size, "sample.num_shards=2", "sample.shard=0,1", "seed=1,2").code == 0
    for seed in (1, 2):
        data = artifacts.load(tmp_path / "outputs" / "shared" / f"seed={seed}" / "dataset")
        assert data["seed"].tolist() == [seed] * 4


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_shards_are_made_by_processes_side_by_side(tmp_path, launcher) -> None:
    if launcher == "submitit_local":
        pytest.importorskip(
            "hydra_plugins.hydra_submitit_launcher", reason="needs the extra cluster, which dev includes"
        )
    size = ["stages=[sample]", "robot=qj_22", "sample.num_samples=64", "sample.shard_size=8"]
    shards = ["sample.shard=0,1,2,3", f"hydra/launcher={launcher}"]
    for arguments in (["-m", "name=shared", *shards], ["name=shared"], ["name=alone"]):
        with in_a_process(["-m", "qjrl", *size, *arguments], tmp_path) as process:
            out, error = process.communicate()
        assert process.returncode == 0, error
        if arguments == ["name=shared"]:
            assert "sample: done before and unchanged, skipped" in out
    shared, alone = (artifacts.load(tmp_path / "outputs" / name / "dataset") for name in ("shared", "alone"))
    for name, column in shared.items():
        assert column.tobytes() == alone[name].tobytes(), name


WAITING = """
import sys, time
from qjrl import pipeline
from qjrl.__main__ import main

def wait(*_):
    print("waiting", flush=True)
    time.sleep(60)

pipeline.build_configs = lambda *_: None
pipeline.run = wait
sys.exit(main())
"""


def test_ctrl_c_says_how_to_go_on(tmp_path) -> None:
    with in_a_process(["-c", WAITING, "stages=[sample]", "seed=99"], tmp_path) as process:
        assert process.stdout is not None
        while "waiting" not in process.stdout.readline():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert error.strip() == "interrupted; to go on: qjrl 'stages=[sample]' seed=99"
    summary = json.loads((tmp_path / "outputs" / "default" / "summary.json").read_text())
    assert summary["status"] == "interrupted"


@pytest.mark.slow
def test_all_stages_run_on_mjx(tmp_path) -> None:
    """In a process of its own: MJX compiles several times, for minutes. The policy trains in it, too."""
    small = [
        "sample.num_samples=24",
        "ik.num_held_out=4",
        "ik.num_bank=6",
        "policy.num_evaluated=1",
        "policy.num_envs=8",
    ]
    steps = ["policy.ppo.num_steps=320", "policy.ppo.checkpoint_every=1"]
    command = [sys.executable, "-m", "qjrl", "+experiment=smoke", "simulation=mjx", "robot=qj_22", *small, *steps]
    done = subprocess.run([*command, f"hydra.run.dir={tmp_path}"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert artifacts.load(tmp_path / "dataset")["converged"].mean() > 0.9
    assert artifacts.load(tmp_path / "policy" / "metrics.json")["invalid_steps"] == 0
    assert (tmp_path / "compare" / "report.html").stat().st_size > 100_000
