import re
import tomllib
from pathlib import Path

from qjrl.provenance import PACKAGES

PROJECT = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]


def test_the_versions_recorded_are_those_of_the_package_and_of_what_it_depends_on() -> None:
    required = {re.split(r"[\[<>=!~ ;]", one)[0] for one in PROJECT["dependencies"]}
    assert {*PACKAGES} <= {"qjrl", "jaxlib", *required}  # jaxlib: of jax
    assert len({*PACKAGES}) == len(PACKAGES)
