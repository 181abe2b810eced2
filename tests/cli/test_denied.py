"""Places where the machine does not let the command write."""

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from command import Command, assert_one_line


@contextlib.contextmanager
def unchangeable(path: Path) -> Iterator[None]:
    """A directory in which nobody may make a file, the superuser included."""
    if os.geteuid() == 0:
        if shutil.which("chattr") is None or subprocess.run(["chattr", "+i", path], check=False).returncode:
            pytest.skip("needs a file system with chattr +i, or a user who is not the superuser")
        undo = ["chattr", "-i", path]
    else:
        path.chmod(0o555)
        undo = ["chmod", "755", path]
    try:
        yield
    finally:
        subprocess.run(undo, check=True)


@pytest.mark.parametrize(
    "place", [".", "outputs", "outputs/default", "outputs/default/dataset", "outputs/default/model"]
)
def test_a_directory_that_may_not_be_changed_is_one_line(qjrl: Command, place) -> None:
    Path(place).mkdir(parents=True, exist_ok=True)
    for arguments in ([], ["-m", "seed=1,2"]):
        if arguments and place not in (".", "outputs", "outputs/default"):
            continue
        with unchangeable(Path(place)):
            said = qjrl(*arguments)
        assert said.code == 1, said
        assert "Traceback" not in said.out + said.err
        lines = set(said.err.splitlines())
        assert 1 <= len(lines) <= max(1, 2 * bool(arguments))
        assert all("Operation not permitted" in line or "Permission denied" in line for line in lines), lines


@pytest.mark.parametrize("place", ["outputs", "outputs/default", "outputs/default/dataset"])
@pytest.mark.parametrize("arguments", [(), ("-m", "seed=1,2")], ids=["one", "sweep"])
def test_a_file_in_the_place_of_a_directory_is_one_line(qjrl: Command, place, arguments) -> None:
    Path(place).parent.mkdir(parents=True, exist_ok=True)
    Path(place).write_text("")
    if arguments and place.endswith("dataset"):
        Path(place).unlink()
        Path("outputs/default/seed=1").mkdir(parents=True)
        Path("outputs/default/seed=1/dataset").write_text("")
    said = qjrl(*arguments)
    assert said.code in (1, 2)
    assert "Traceback" not in said.out + said.err
    lines = said.err.splitlines()
    assert 1 <= len(lines) <= 2
    assert all(Path(place).name in line for line in lines), lines


def test_a_lock_that_may_not_be_opened_and_a_record_that_is_a_directory_are_one_line(qjrl: Command) -> None:
    Path("outputs/default/.lock").mkdir(parents=True)
    assert_one_line(qjrl(), ".lock", code=(1, 2))
    Path("outputs/other/summary.json").mkdir(parents=True)
    assert_one_line(qjrl("name=other"), "summary.json", code=(1, 2))
