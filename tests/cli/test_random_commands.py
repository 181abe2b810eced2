"""Whatever is typed, and whatever became of the files: the command works, or says one line."""

import dataclasses
import json
import random
import shutil
from pathlib import Path
from typing import Any

import pytest
from command import Command, Said, assert_one_line
from hydra._internal.hydra import Hydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from qjrl import pipeline, provenance
from qjrl.cli import launch
from qjrl.cli.arguments import for_hydra, sorted_out
from qjrl.cli.outcome import EXIT_CODES, one_line
from qjrl.cli.robot_files import with_robot_files
from qjrl.config import ConfigError, conf_folder, read_yaml
from qjrl.robot import load_robot

CHOICES = {"robot": "qj_22", "simulation": "mujoco"}


def assert_told(said: Said, about: Any, most_runs: int = 1) -> None:
    """It works, or says one line; a sweep one for each of its runs."""
    try:
        assert "Traceback" not in said.out + said.err
        if said.code:
            lines = said.err.splitlines() if most_runs > 1 else [said.err]
            assert 1 <= len(lines) <= most_runs
            for line in lines:
                assert_one_line(dataclasses.replace(said, err=line), code=(1, 2))
    except AssertionError as error:
        raise AssertionError(f"{about!r}: {error}") from error


MOST_RUNS = 8
"""Of a sweep: three keys with two values each."""


@pytest.fixture(autouse=True)
def _composed_once(monkeypatch) -> None:
    """Hydra composes once more beforehand, only to see whether `hydra.mode` is set; no command here sets it."""
    monkeypatch.setattr(Hydra, "get_mode", lambda *_, **__: None)


KEYS = (
    *(
        "seed",
        "name",
        "stages",
        "robot",
        "robot.link_length",
        "robot.joint.bend_limit_deg",
        "robot.cables.hole_angles_deg",
    ),
    *("simulation", "simulation.timestep", "simulation.num_threads", "+robot.new", "++seed", "~seed", "~robot.joint"),
    *(
        "sed",
        "robot.",
        ".",
        "",
        "robot@x",
        "hydra.job.name",
        "+a.b.c",
        "größe",
        "robot.joint.bend_limit_deg.x",
        "-seed",
    ),
)
VALUES = (
    *("1", "-1", "1e20", "1e400", "nan", "inf", "null", "true", "one", "065", "0x1F", "1_000", "1:30", "[]", "{}", "[1", "}"),
    *("[[1,2],[3]]", "{a: 1}", "'", '"', "'a'", "''", "a b", "a,b", "\\", "\\\\", "${seed}", "${", "${nothing}", "$", "???"),
    *("Größe", "名前", "é,ü", "\t", "\n", "\0x", "\x1b[31m", "..", "../../x", "/", "~", "a/b", "x" * 300, "9" * 400),
    *("(1)", "range(1,3)", "choice(1,2)", "glob(*)", "int(1.5)", "=", "a=b", "#", "%", "qj_2222", "nowhere.yaml", "."),
    *("first", "[first]", "[second,first]", "[first,1]", "mjx", "mujoco", "0.03", "[0,90]", "!!int 3", "&a", "*a", "@"),
)  # fmt: skip
WORDS = (
    "",
    "first",
    "x",
    "--foo",
    "--cfg",
    "-m",
    "--info=x",
    "--cfg=no",
    "-",
    "--",
    "a.yaml",
    "é",
    "-x=1",
    "\0",
    "--resolve",
)


def random_command(draw: random.Random) -> list[str]:
    arguments = [f"{draw.choice(KEYS)}={draw.choice(VALUES)}" for _ in range(draw.choice([1, 1, 1, 2, 3]))]
    if draw.random() < 0.15:
        arguments.insert(draw.randrange(len(arguments) + 1), draw.choice(WORDS))
    if draw.random() < 0.2:
        letters = [chr(draw.choice([*range(32, 127), 0xE9, 0x540D, 10])) for _ in range(draw.randrange(12))]
        arguments.append(f"{draw.choice(KEYS)}={''.join(letters)}")
    return arguments


def try_commands(qjrl: Command, count: int, seed: int) -> None:
    draw, codes = random.Random(seed), set()
    for _ in range(count):
        arguments = random_command(draw)
        said = qjrl(*arguments)
        assert_told(said, arguments, MOST_RUNS if "-m" in arguments else 1)
        codes.add(said.code)
    assert {0, 2} <= codes


@pytest.mark.parametrize("value", ["${nothing}", "${seed", "${seed}", "${robot.link_length}", "${name}", "${now:x"])
@pytest.mark.parametrize(
    "key", ["simulation.timestep", "seed", "++seed", "robot.joint.bend_limit_deg", "stages", "name"]
)
def test_a_value_that_refers_to_another_works_or_is_one_line(qjrl, key, value) -> None:
    assert_told(qjrl(f"{key}={value}"), (key, value))


def test_a_sweep_over_a_reference_that_leads_nowhere_keeps_the_record_of_every_run(qjrl) -> None:
    said = qjrl("-m", "simulation.timestep=${nothing}", "seed=1,2")
    assert said.code == 1
    assert said.err.splitlines() == 2 * ["simulation.timestep: Interpolation key 'nothing' not found"]
    rows = json.loads(Path("outputs/default/sweep.json").read_text())
    assert [row["status"] for row in rows] == ["bad input", "bad input"]


def test_random_commands_work_or_are_one_line(qjrl) -> None:
    try_commands(qjrl, 30, 1)


def test_a_thousand_random_commands_reach_hydra_s_parser_or_are_one_line(qjrl) -> None:
    """Without composing, which takes most of the time: what goes wrong is an error that the door tells in one line."""
    draw, read = random.Random(3), 0
    for _ in range(1000):
        arguments = random_command(draw)
        try:
            overrides, _ = sorted_out(arguments, pipeline.STAGES)
            overrides, _ = with_robot_files(overrides)
            OverridesParser.create().parse_overrides([for_hydra(override) for override in overrides])
            read += 1
        except (ConfigError, HydraException) as error:
            assert one_line(str(error)), arguments
    assert 300 < read < 1000


@pytest.mark.slow
def test_a_thousand_random_commands_work_or_are_one_line(qjrl) -> None:
    try_commands(qjrl, 1000, 2)


SCALARS = (
    *(
        "065",
        "1:30",
        "yes",
        "on",
        "0o17",
        "2024-05-01",
        "1_000",
        "=",
        "~",
        "null",
        ".nan",
        ".inf",
        "1e400",
        "-1",
        "0",
        "''",
    ),
    *(
        "'0.03'",
        "[1, 2]",
        "{a: 1}",
        "!!int 3",
        "!!str 3",
        "&a 3",
        "*a",
        "${seed}",
        "???",
        "{",
        "9" * 400,
        "0.03",
        "30 mm",
        "é",
    ),
)


def random_robot(draw: random.Random) -> str:
    """The shipped description with a few lines changed, doubled, left out or torn."""
    lines = (conf_folder() / "robot" / "qj_22.yaml").read_text().splitlines()
    for _ in range(draw.choice([1, 1, 2, 3])):
        row = draw.choice([row for row, line in enumerate(lines) if ":" in line and not line.startswith("#")])
        key = lines[row].partition(":")[0]
        change = draw.random()
        if change < 0.7:
            lines[row] = f"{key}: {draw.choice(SCALARS)}"
        elif change < 0.8:
            lines.insert(row, lines[row])
        elif change < 0.9:
            del lines[row]
        else:
            lines.insert(
                row, draw.choice(["defaults: [x]", "\tx: 1", "new: 1", "1: 2", "- 1", "<<: 3", "---", "%YAML 1.1"])
            )
    return "\n".join(lines) + "\n"


def test_one_random_robot_means_the_same_through_both_doors(qjrl) -> None:
    try_robots(qjrl, 15, 4)


@pytest.mark.slow
def test_many_random_robots_mean_the_same_through_both_doors(qjrl) -> None:
    try_robots(qjrl, 200, 6)


def try_robots(qjrl: Command, count: int, seed: int) -> None:
    draw, refused = random.Random(seed), 0
    for number in range(count):
        path = Path(f"arm_{number}.yaml")
        path.write_text(random_robot(draw), encoding="utf-8")
        try:
            load_robot(path)
            line = None
        except ConfigError as error:
            line = " ".join(str(error).split())
        said = qjrl(f"robot={path}", "stages=[first]", f"name=run_{number}")
        assert_told(said, path.read_text())
        assert (said.code == 0) == (line is None), (said.err, line)
        assert line is None or said.err.strip() == line
        refused += line is not None
    assert refused > count / 4


def damaged(draw: random.Random, path: Path) -> None:
    """A file truncated, with bytes flipped, of another kind, empty, or a directory in its place."""
    content, way = path.read_bytes(), draw.randrange(6)
    if way == 0:
        path.write_bytes(content[: draw.randrange(len(content))])
    elif way == 1:
        flipped = bytearray(content)
        for _ in range(draw.choice([1, 3, 30])):
            flipped[draw.randrange(len(flipped))] ^= 1 << draw.randrange(8)
        path.write_bytes(flipped)
    elif way == 2:
        path.write_text(
            json.dumps(draw.choice([{}, [], None, 3, "x", [{}], {"output_hash": 3}, {"format": 1, "shards": 3}]))
        )
    elif way == 3:
        path.write_bytes(b"")
    elif way == 4:
        path.unlink()
        path.mkdir()
    elif path.suffix == ".json" and isinstance(record := json.loads(content), dict) and record:
        record[draw.choice(list(record))] = draw.choice([None, 3, "x", [], {}, [3], [{}]])
        path.write_text(json.dumps(record))


def test_two_hundred_damaged_files_are_one_line_or_do_no_harm(qjrl, capsys, monkeypatch) -> None:
    """Behind Hydra, which takes most of the time and reads none of these files."""
    monkeypatch.setattr(provenance, "_commit", lambda: None)
    tree = {"seed": 1, "stages": ["first", "second"], "name": "run"}
    tree |= {group: read_yaml(conf_folder() / group / f"{choice}.yaml") for group, choice in CHOICES.items()}

    def run() -> Said:
        status, _ = launch.run_stages(tree, run_dir)
        return Said(EXIT_CODES[status], *capsys.readouterr())

    assert qjrl("name=whole", "seed=1").code == 0
    whole, run_dir, draw, codes = Path("outputs/whole"), Path("outputs/run"), random.Random(5), set()
    files = sorted(path.relative_to(whole) for path in whole.rglob("*") if path.is_file() and path.name != ".lock")
    assert {"done.json", "provenance.json", "manifest.json", "metrics.json"} <= {file.name for file in files}
    for _ in range(200):
        shutil.rmtree(run_dir, ignore_errors=True)
        shutil.copytree(whole, run_dir)
        file = draw.choice(files)
        for stage in ("dataset", "model"):  # a stage that goes on reads more than one that is done
            if draw.random() < 0.5 and file != Path(stage, "done.json"):
                (run_dir / stage / "done.json").unlink()
        damaged(draw, run_dir / file)
        said = run()
        assert_told(said, (file, said))
        codes.add(said.code)
    assert {0, 2} <= codes <= {0, 1, 2}
