"""Names, files, sweeps and machines as a user meets them at the door; the stages behind it are two small ones."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command import Command, assert_one_line
from hypothesis import given
from hypothesis import strategies as st

from qjrl import artifacts, machine, pipeline, plain_yaml, progress, stage, sweep
from qjrl.cli import outcome
from qjrl.cli.arguments import for_hydra, quoted, sorted_out
from qjrl.cli.names import job_name
from qjrl.config import ConfigError, as_mapping, conf_folder
from qjrl.robot import load_robot
from qjrl.simulation.settle_problem import SettleConfig

ROOT = Path(__file__).parent.parent.parent
ARM = (conf_folder() / "robot" / "qj_22.yaml").read_text()
ODD = (
    "Größe.yaml",
    "2024.yaml",
    "nan.yaml",
    "a,b.yaml",
    "my arm.yaml",
    "it's.yaml",
    'the "arm".yaml',
    "[x]{y}(z).yaml",
    "$x=.yaml",
)


@pytest.mark.parametrize("name", ODD)
def test_a_robot_s_file_may_have_any_name_and_the_record_holds_it(qjrl: Command, name) -> None:
    Path(name).write_text(ARM.replace("link_length: 0.030", "link_length: 0.041"))
    said = qjrl(f"robot={name}", "stages=[first]", "simulation.timestep=0.003")
    assert said.code == 0, said.err
    assert artifacts.load("outputs/default/dataset/provenance.json")["config"]["robot"]["link_length"] == 0.041
    assert f"robot={name}" in artifacts.load("outputs/default/summary.json")["overrides"]


def test_a_sweep_over_files_with_odd_names_and_paths_stays_in_its_directory(qjrl: Command, tmp_path) -> None:
    names = ("../a.yaml", "Größe.yaml", "b,c.yaml", f"{'long' * 60}.yaml")
    for name in names:
        Path(name).write_text(ARM)
    before = set(tmp_path.iterdir())
    said = qjrl("-m", f"robot={','.join(names)}", "stages=[first]")
    assert said.code == 0, said.err
    rows = artifacts.load("outputs/default/sweep.json")
    assert len({row["job"] for row in rows}) == 4 and all("/" not in row["job"] for row in rows)
    assert {row["overrides"][0] for row in rows} == {f"robot={name}" for name in names}
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "text", ["", "a: 1\na: 2\n", "defaults: [x]\n" + ARM, ARM.replace("name: qj_22", "name: ${seed}")]
)
def test_one_file_is_refused_in_the_same_words_by_both_doors(qjrl: Command, text) -> None:
    Path("mine.yaml").write_text(text)
    with pytest.raises(ConfigError) as error:
        load_robot("mine.yaml")
    assert_one_line(qjrl("robot=mine.yaml", "stages=[first]"), str(error.value), "mine.yaml")


def test_a_key_that_stands_twice_is_named_with_the_user_s_file_and_line(qjrl: Command) -> None:
    Path("mine.yaml").write_text(ARM + "schema: 1\n")
    assert_one_line(qjrl("robot=mine.yaml"), f"mine.yaml: is not YAML: line {ARM.count(chr(10)) + 1}: the key 'schema'")


def test_zero_padded_angles_are_decimal_at_both_doors(qjrl: Command) -> None:
    Path("mine.yaml").write_text(ARM.replace("bend_limit_deg: 70.0", "bend_limit_deg: 065"))
    assert load_robot("mine.yaml").config.joint.bend_limit_deg == 65.0
    assert qjrl("robot=mine.yaml", "stages=[first]").code == 0
    assert artifacts.load("outputs/default/dataset/provenance.json")["config"]["robot"]["joint"]["bend_limit_deg"] == 65


@pytest.mark.parametrize(
    "arguments", [["--cfg", "job", "robot=2024.yaml"], ["robot=2024.yaml", "--cfg", "job", "seed=3"]]
)
def test_options_may_stand_anywhere(qjrl: Command, arguments) -> None:
    Path("2024.yaml").write_text(ARM)
    assert "link_length: 0.03" in qjrl(*arguments).out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["first"], ["did you mean stages=[first]?"]),
        (["first", "second"], ["did you mean stages=[first,second]?"]),
        (["arm.yaml"], ["did you mean robot=arm.yaml?"]),
        (["--foo"], ["--foo: no such option"]),
        (["--cfg", "jop"], ["--cfg: got 'jop', allowed: job, hydra, all"]),
        (["name=../../x"], ["name: got '../../x'"]),
        (["name="], ["name: got ''"]),
        (["name=/tmp/x"], ["name: got '/tmp/x'"]),
        (["-m", "seed=1,2", "name=a/../.."], ["name: got 'a/../..'"]),
        (["seed=-1"], ["seed: got -1, allowed: an integer from 0 to 4294967295"]),
        (["seed=1e20"], ["seed: got 1e+20"]),
        (["seed=one"], ["seed: got 'one'"]),
        (["robot=a.yaml,b.yaml"], ["a.yaml: cannot be read"]),
        (["robot.x='"], ["robot.x='"]),
    ],
    ids=str,
)
def test_a_slip_is_named_before_any_directory_is_made(qjrl: Command, arguments, words) -> None:
    assert_one_line(qjrl(*arguments), *words)
    assert not list(Path().rglob("dataset"))
    assert not list(Path.cwd().parent.parent.glob("x"))


@pytest.mark.parametrize("name", ["Größe", "2024", "O'Brien", "a b", "a/b", "null", 'say "x"'])
def test_a_run_may_have_any_name_that_a_directory_may_have(qjrl: Command, name) -> None:
    assert qjrl(f"name={name}", "stages=[first]").code == 0
    assert Path("outputs", name, "dataset", "done.json").exists()


def test_a_damaged_record_and_a_clock_that_runs_back_cost_no_table(qjrl: Command, monkeypatch) -> None:
    for number, content in enumerate(("{", "[]", "{}", '{"status": 3}', "")):
        Path(f"outputs/default/old{number}").mkdir(parents=True)
        Path(f"outputs/default/old{number}/summary.json").write_text(content)
    Path("outputs/default/old9/summary.json").mkdir(parents=True)
    clock = iter(range(10**9, 0, -60))
    monkeypatch.setattr(sweep.time, "time", lambda: float(next(clock)))
    said = qjrl("-m", "seed=1,2")
    assert said.code == 0, said.err
    assert [row["job"] for row in artifacts.load("outputs/default/sweep.json")] == ["seed=1", "seed=2"]
    assert [row["metrics"]["model.mean"] for row in artifacts.load("outputs/default/sweep.json")] == [1.0, 2.0]
    assert said.out.count("left out of the table") == 6


@given(st.text(max_size=300))
def test_every_value_gives_the_name_of_one_directory(value) -> None:
    name = job_name(value)
    assert "/" not in name and "\0" not in name and name not in ("", ".", "..") and not name.startswith(".")
    assert 0 < len(name.encode()) < 255


@given(st.lists(st.text(max_size=40), min_size=2, max_size=5, unique=True))
def test_other_values_give_other_names(values) -> None:
    assert len({job_name(value) for value in values}) == len(values)


@given(st.text(max_size=30).filter(lambda text: "${" not in text))
def test_hydra_reads_a_quoted_text_as_it_is(text) -> None:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    assert OverridesParser.create().parse_override(f"key={quoted(text)}").value() == text


def test_a_list_of_letters_beyond_ascii_stays_a_list() -> None:
    assert for_hydra("key=[é,b]") == "key=['é',b]"
    assert for_hydra("key=é,ü") == "key='é','ü'"
    assert sorted_out(["-m", "a=1", "--cfg=job", "b=2"], []) == (["a=1", "b=2"], ["-m", "--cfg", "job"])


# --- errors of the machine --------------------------------------------------------------------------------------------


def test_a_full_disk_is_one_line_and_the_same_command_goes_on(qjrl: Command, monkeypatch) -> None:
    write, calls, room = os.fsync, [], [0]

    def full(file: int) -> None:
        calls.append(file)
        if len(calls) >= room[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(file)

    for files in (1, 4, 7):
        calls.clear()
        room[0] = files
        with monkeypatch.context() as context:
            context.setattr(os, "fsync", full)
            assert_one_line(qjrl("seed=3"), "No space left on device", code=1)
    assert qjrl("seed=3").code == 0
    assert artifacts.load("outputs/default/model/metrics.json") == {"mean": 3.0, "nothing": None}


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("4 GiB"),
        RuntimeError("RESOURCE_EXHAUSTED: out of memory\nmore"),
        PermissionError(13, "Permission denied", "x"),
    ],
)
def test_what_the_machine_lacks_is_one_line_and_a_bug_is_a_traceback(error, capsys) -> None:
    assert outcome.tell(error)[0] == "failed"
    assert len(capsys.readouterr().err.splitlines()) == 1
    for bug in (FileNotFoundError(2, "No such file", "x"), KeyError("x"), RuntimeError("x"), AssertionError()):
        assert outcome.tell(bug)[0] == "failed"
        assert f"{type(bug).__name__}" in capsys.readouterr().err and machine.line_of(bug) is None


def test_a_lock_that_another_process_holds_is_the_machine_s_and_one_line(qjrl: Command) -> None:
    with stage.alone_in(Path("outputs/default")):
        assert_one_line(qjrl(), "another run is at work here", code=1)


def test_no_device_is_one_line(qjrl: Command, monkeypatch) -> None:
    import jax

    def none() -> None:
        raise AssertionError

    monkeypatch.setattr(jax, "devices", none)
    assert_one_line(qjrl(), "JAX finds no device", code=1)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_a_line_for_the_eye_never_ends_the_work(tmp_path, encoding) -> None:
    program = "from qjrl import progress\nfor text in ('compiling …', '20°', '╭╮'):\n    progress.console.print(text)\nprint('end')"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": encoding}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, check=False)
    assert done.returncode == 0 and done.stdout.endswith(b"end\n"), done.stderr


def test_a_closed_pipe_swallows_what_nobody_reads() -> None:
    class Closed:
        encoding = "ascii"

        def write(self, text: str) -> None:
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    eye = progress.Eye(Closed())
    assert eye.write("é") == 1
    assert eye.write("x") == 1
    eye.flush()


def test_a_stage_that_is_not_asked_for_is_not_imported(qjrl: Command, monkeypatch) -> None:
    broken = pipeline.STAGES | {"third": pipeline.Stage("no_such_module", "breaks", writes="third")}
    monkeypatch.setattr(pipeline, "STAGES", broken)
    monkeypatch.setattr(pipeline, "GROUPS", pipeline.GROUPS | {"third": "third"})
    assert qjrl("stages=[first]").code == 0
    assert qjrl("stages=[third]").code == 1
    assert qjrl("stages=[first]", "third.speed=1").code == 1  # who can say whether that is allowed


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "simulation.timestp=0.004",
            "simulation.timestp: got 0.004, but there is no such key; did you mean 'timestep'?",
        ),
        ("+simulation.timestp=0.004", "did you mean 'timestep'?"),
        ("simulation={timestp: 0.004}", "simulation"),
        ("smulation.timestep=0.004", "did you mean 'simulation'?"),
        ("seed=${simulation.timestp}", "seed: Interpolation key 'simulation.timestp' not found"),
        ("simulation.timestep=-1", "simulation.timestep: got -1"),
    ],
)
def test_a_key_that_has_a_default_in_python_alone_is_held_against_its_dataclass(qjrl: Command, override, words) -> None:
    assert_one_line(qjrl("stages=[first]", override), words)
    assert qjrl("stages=[first]", "simulation.timestep=0.003", "name=fine").code == 0


def test_a_value_may_refer_to_one_that_only_python_states(qjrl: Command) -> None:
    assert qjrl("stages=[first]", "seed=${simulation.batch_size}", "name=by_value").code == 0
    assert artifacts.load(Path("outputs/by_value/dataset"), "robot")["pose"][0, 0] == SettleConfig().batch_size
    assert qjrl("stages=[first]", "hydra.run.dir=outputs/of_${simulation.batch_size}").code == 0
    assert Path(f"outputs/of_{SettleConfig().batch_size}/dataset").is_dir()


def test_what_is_printed_holds_every_key(qjrl: Command) -> None:
    said = qjrl("--cfg", "job", "simulation.timestep=0.003")
    printed = plain_yaml.load(said.out)
    assert said.code == 0 and printed["simulation"] == as_mapping(SettleConfig(timestep=0.003))
    assert printed["stages"] == ["first", "second"] and not Path("outputs").exists()


def test_a_run_that_is_terminated_leaves_no_folder_behind(tmp_path) -> None:
    program = (
        "import sys, time\nfrom qjrl import pipeline\nfrom qjrl.__main__ import main\n"
        "pipeline.meet = lambda tree: (print('waiting', flush=True), time.sleep(60))\nsys.exit(main())"
    )
    (tmp_path / "mine.yaml").write_text(ARM)
    (tmp_path / ".qjrl-old").mkdir()
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", program, "robot=mine.yaml", "stages=[sample]"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        deadline = time.monotonic() + 60
        while "waiting" not in process.stdout.readline():
            assert time.monotonic() < deadline and process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == -signal.SIGTERM
    assert {path.name for path in tmp_path.iterdir()} == {"mine.yaml", ".qjrl-old", "outputs"}
    assert json.loads((tmp_path / "outputs/default/summary.json").read_text())["status"] == "running"


# --- robot files and the place of the output ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("mine.yaml", ARM.replace("link_length: 0.030", "link_length: -1"), "robot.link_length: got -1"),
        ("MINE.YAML", ARM.replace("name: qj_22", 'name: ""'), "robot.name: got ''"),
        ("mine.yml", "robot:\n" + "".join(f"  {line}\n" for line in ARM.splitlines()), "without robot: above them"),
        ("mine.yaml", ARM.encode("utf-16"), "it is in UTF-16, allowed: UTF-8; save it as UTF-8"),
        ("mine.yaml", ARM.encode("utf-16-le"), "save it as UTF-8"),
        ("mine.yaml", (ARM + "# 关节\n").encode("gbk"), "save it as UTF-8"),
    ],
    ids=range(6),
)
def test_both_doors_name_the_robot_s_file_and_what_is_wrong_in_it(qjrl: Command, name, content, words) -> None:
    Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError) as error:
        load_robot(name)
    assert str(error.value).startswith(f"{name}: ") and words in str(error.value)
    assert_one_line(qjrl(f"robot={name}", "stages=[first]"), str(error.value))


def test_a_value_that_the_command_changes_is_not_blamed_on_the_file(qjrl: Command) -> None:
    Path("mine.yaml").write_text(ARM)
    said = qjrl("robot=mine.yaml", "robot.link_length=-2", "stages=[first]")
    assert_one_line(said, "robot.link_length: got -2")
    assert "mine.yaml" not in said.err


def test_a_place_where_nothing_can_be_written_is_an_error_of_the_machine(qjrl: Command, tmp_path) -> None:
    Path("outputs").symlink_to(tmp_path / "nowhere" / "deep")
    assert_one_line(qjrl("stages=[first]"), "outputs: cannot be made", "a link to", code=1)
    assert_one_line(qjrl("stages=[first]", "hydra.run.dir=/proc/qjrl"), "/proc/qjrl: cannot be made", code=1)
    gone = tmp_path / "gone"
    gone.mkdir()
    os.chdir(gone)
    gone.rmdir()
    assert_one_line(qjrl("stages=[first]"), "the current directory does not exist any more", code=1)
    os.chdir(tmp_path)
