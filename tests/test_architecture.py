"""The floors of the house: imports point down, none across except inside one folder."""

import ast
import graphlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from qjrl.robot.kinds import KINDS

PACKAGE = Path(__file__).parent.parent / "qjrl"
FILES = sorted(PACKAGE.rglob("*.py"))
FLOORS = {
    "__init__": 0,
    "geometry": 1,
    "learning": 1,
    "config": 1,
    "artifacts": 1,
    "cores": 1,
    "keys": 1,
    "xla_options": 1,
    "progress": 1,
    "robot": 2,
    "simulation": 3,
    "solvers": 3,
    "control": 4,
    "deployment": 4,
    "report": 4,
    "stages": 5,
    "studies": 5,
    "pipeline": 6,
    "cli": 7,
    "__main__": 8,
}
# Beside the floors of the design: the record of where a result comes from, how a stage is run, the table over the runs
# of a sweep.
FLOORS |= {
    "provenance": 1.5,
    "kept": 1,
    "table_file": 1.5,
    "csv_rows": 1,
    "measured": 1.5,
    "stage_config": 3,
    "stage": 5.5,
    "sweep": 6,
}
# What the ground stands on: YAML and JSON as they are read and written, errors of the machine.
FLOORS |= {"plain_yaml": 0, "plain_json": 0, "machine": 0, "records": 0, "field_words": 0, "text_file": 0}
FLOORS |= {"tagged_union": 0.5}
DOOR = {"cli", "__main__"}
GROUND = {"config", "artifacts", "keys", "progress", "xla_options"}
"""The files of floor 1 that the folders of floor 1 may use too."""


def modules_imported(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import; name the package"
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def part_of(module: str) -> str | None:
    """The folder or file of the package that a module belongs to: `qjrl.robot.loading` -> `robot`."""
    names = module.split(".")
    return names[1] if names[0] == "qjrl" and len(names) > 1 and names[1] in FLOORS else None


def own_part(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.relative_to(PACKAGE).as_posix())
def test_imports_point_down(file: Path) -> None:
    own = own_part(file)
    assert own in FLOORS, f"{own} has no floor"
    for part in {part_of(module) for module in modules_imported(file)} - {None, own}:
        assert part is not None
        is_ground = part in GROUND and own not in GROUND and FLOORS[own] >= 1
        assert FLOORS[part] < FLOORS[own] or is_ground, f"{own} (floor {FLOORS[own]}) imports {part} ({FLOORS[part]})"


def folder_of(module: str) -> tuple[str, ...]:
    """The folder below a part of the package that a module lies in: `qjrl.control.path.files` -> `control`, `path`."""
    names = module.split(".")[1:]
    return tuple(names[:2]) if PACKAGE.joinpath(*names[:2]).is_dir() else ()


def folders_imported() -> dict[tuple[str, ...], set[tuple[str, ...]]]:
    """Folder below a part of the package -> the other folders of the same part that its files import."""
    found: dict[tuple[str, ...], set[tuple[str, ...]]] = {}
    for file in FILES:
        own = folder_of(".".join(("qjrl", *file.relative_to(PACKAGE).with_suffix("").parts)))
        others = {folder_of(module) for module in modules_imported(file) if part_of(module) == own_part(file)}
        found.setdefault(own, set()).update(others - {own, ()})
    return found


def test_no_study_imports_another() -> None:
    assert not {own: others for own, others in folders_imported().items() if own[:1] == ("studies",) and others}


def test_no_two_folders_side_by_side_import_each_other() -> None:
    found = folders_imported()
    below = {own: others for own, others in found.items() if own}
    tuple(graphlib.TopologicalSorter(below).static_order())  # raises CycleError, naming the folders
    assert ("control", "tracking") not in found["control", "tension"]
    assert ("control", "tension") not in found["control", "tracking"]


def test_only_its_own_folder_and_studies_know_a_kind_of_robot() -> None:
    """But for what hands on its public names: the registries of kinds and of models, the verbs and the solvers' door."""
    kinds = tuple(f"qjrl.robot.{name}." for name in KINDS)
    knowing = {
        file.relative_to(PACKAGE).as_posix()
        for file in FILES
        if any(f"{module}.".startswith(kinds) for module in modules_imported(file))
        and file.parent.name not in KINDS
        and file.relative_to(PACKAGE).parts[0] != "studies"
    }
    assert knowing == {"robot/kinds.py", "robot/model_kinds.py", "robot/verbs.py", "solvers/__init__.py"}


def files_importing(*packages: str) -> set[str]:
    roots = {file: {module.split(".")[0] for module in modules_imported(file)} for file in FILES}
    return {own_part(file) for file, imported in roots.items() if imported & set(packages)}


def test_only_the_door_knows_hydra() -> None:
    assert files_importing("hydra", "omegaconf") <= {"cli"}


def test_only_the_report_and_studies_draw_with_matplotlib() -> None:
    assert files_importing("matplotlib") <= {"report", "studies"}


def test_only_progress_and_the_door_know_rich() -> None:
    assert files_importing("rich") <= {"progress", "cli"}


def test_nothing_is_ever_pickled() -> None:
    assert not files_importing("pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal")
    assert not [file for file in FILES if "allow_pickle=True" in file.read_text()]


def test_annotations_are_not_postponed_because_the_shape_checker_needs_them() -> None:
    assert not [file for file in FILES if "__future__.annotations" in set(modules_imported(file))]


def test_nothing_below_the_door_prints_or_touches_the_environment() -> None:
    for file in FILES:
        if own_part(file) in DOOR:
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            assert not (isinstance(node, ast.Name) and node.id == "print"), f"{file} prints"
            assert not (isinstance(node, ast.Attribute) and node.attr in ("environ", "putenv")), f"{file}: environment"


def test_no_file_is_named_for_what_is_left_over() -> None:
    assert not [file for file in FILES if file.stem in ("utils", "util", "helpers", "common", "misc")]


def test_no_file_or_function_is_too_long_to_read() -> None:
    for file in FILES:
        text = file.read_text()
        assert len(text.splitlines()) <= 300, f"{file} has more than 300 lines"
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                assert (node.end_lineno or 0) - node.lineno < 60, f"{file}: {node.name} has more than 60 lines"
