"""experiments/accelerator/measure.py at the smallest sizes, on whatever this machine has, in a process of its own."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SMALL = ["--robot", "qj_22", "--rows", "16", "--arms", "4", "--steps", "1"]
KEYS = {
    "fitting": {"rows", "batch_size", "first_seconds", "epoch_seconds", "rows_per_second", "loss"},
    "solving": {"targets", "first_seconds", "targets_per_second", "solved_share"},
    "training": {
        "arms",
        "setup_seconds",
        "dagger_first_seconds",
        "dagger_steps_per_second",
        "ppo_first_seconds",
        "ppo_steps_per_second",
        "ppo_iterations",
        "ppo_collecting_seconds",
        "ppo_learning_seconds",
    },
}


def measure(*arguments: str) -> "subprocess.CompletedProcess[str]":
    program = [sys.executable, str(ROOT / "experiments" / "accelerator" / "measure.py"), *arguments]
    return subprocess.run(program, cwd=ROOT, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)


@pytest.mark.slow
def test_every_case_without_mjx_fills_its_row_with_finite_numbers(tmp_path) -> None:
    done = measure(str(tmp_path / "table.json"), *SMALL, "--cases", "fitting", "3", "1")
    assert done.returncode == 0, done.stderr
    table = json.loads((tmp_path / "table.json").read_text())
    assert table["robot"] == "qj_22" and len(table["devices"]) >= 1
    assert list(table["cases"]) == ["fitting", "solving", "training"]
    for name, row in table["cases"].items():
        assert row.keys() == KEYS[name] | {"case_seconds"}, row
        assert all(math.isfinite(value) for value in row.values())
        assert all(value > 0 for key, value in row.items() if key.endswith("per_second"))
    assert table["cases"]["solving"]["solved_share"] > 0.9
    assert table["cases"]["solving"]["first_seconds"] > 5 * 16 / table["cases"]["solving"]["targets_per_second"]


def test_no_case_starts_when_its_time_is_up(tmp_path) -> None:
    done = measure(str(tmp_path / "table.json"), *SMALL, "--cases", "mjx-training", "--seconds", "-1")
    assert done.returncode == 0, done.stderr
    (row,) = json.loads((tmp_path / "table.json").read_text())["cases"].values()
    assert "had passed" in row["skipped"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--cases", "trainng"], "got trainng, allowed: 1 training, 2 fitting"), (["--steps", "0"], "got 0, allowed")],
)
def test_what_is_not_known_is_refused_before_any_work(tmp_path, arguments, words) -> None:
    done = measure(str(tmp_path / "table.json"), *arguments)
    assert done.returncode == 2 and words in done.stderr
    assert not (tmp_path / "table.json").exists()
