"""Every value stands once: the dataclasses hold the defaults, the shipped files only what is otherwise."""

import copy
import dataclasses
import functools
import sys
from collections.abc import Iterator
from typing import Any, get_type_hints

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from qjrl import pipeline
from qjrl.cli import defaults
from qjrl.config import as_mapping, build, conf_folder, read_yaml, shipped

GROUPS = sorted(path.name for path in conf_folder().iterdir() if path.is_dir() and path.name != "experiment")
EXPERIMENTS = sorted(path.stem for path in (conf_folder() / "experiment").glob("*.yaml"))
OF_SETTINGS = [group for group in GROUPS if group != "robot"]
Place = tuple[str, ...]


def choices_of(group: str) -> list[str]:
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


def choices() -> Iterator[str]:
    yield from (f"+experiment={name}" for name in EXPERIMENTS)
    yield from (f"{group}={choice}" for group in GROUPS for choice in choices_of(group))


def tree_of(*overrides: str, is_whole: bool = True) -> dict[str, Any]:
    """What the command composes: as it prints it, with every key, or as a run gets it."""
    return copy.deepcopy(composed(overrides, is_whole))


@functools.cache
def composed(overrides: tuple[str, ...], is_whole: bool) -> dict[str, Any]:
    may_say_a_kind = is_whole and any(one.startswith("forward_model=") for one in overrides)
    defaults.register(is_whole, composed(overrides, False) if may_say_a_kind else {})
    with initialize_config_dir(version_base=None, config_dir=str(conf_folder())):
        tree = OmegaConf.to_container(compose("config", list(overrides)), resolve=True)
    assert isinstance(tree, dict)
    return {str(key): value for key, value in tree.items()}


def leaves(content: Any, place: Place = ()) -> Iterator[tuple[Place, Any]]:
    if not isinstance(content, dict):
        yield place, content
        return
    for key, value in content.items():
        yield from leaves(value, (*place, key))


def value_at(tree: Any, place: Place) -> Any:
    """None where another kind of settings has no such key; no shipped value is None."""
    for key in place:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def with_its_robot(choice: str) -> tuple[str, ...]:
    """The overrides of a choice; the grey models are of the continuum arm."""
    return (choice, "robot=continuum_4") if choice.startswith("forward_model=grey") else (choice,)


def suitable_stages(overrides: tuple[str, ...]) -> list[str]:
    """All, but for those that need more than the continuum arm offers."""
    if not any("continuum" in one for one in overrides):
        return list(pipeline.STAGES)
    return [name for name in pipeline.STAGES if not {"build_mjcf", "at_pretension", "interface"} & needs_of(name)]


def needs_of(stage: str) -> set[str]:
    return set(getattr(pipeline.STAGES[stage].load().Config, "needs", ()))


@pytest.mark.parametrize("choice", choices())
def test_every_shipped_choice_builds_the_same_from_what_is_printed_and_from_what_is_run(choice) -> None:
    overrides = with_its_robot(choice)
    stages = suitable_stages(overrides)
    configs = pipeline.build_configs(tree_of(*overrides), stages)
    assert {"sample", "forward_model", "ik"} <= configs.keys() == set(stages)
    assert configs == pipeline.build_configs(tree_of(*overrides, is_whole=False), stages)


@pytest.mark.parametrize("choice", choices())
def test_what_is_printed_is_every_value_that_there_is(choice) -> None:
    overrides = with_its_robot(choice)
    tree = tree_of(*overrides)
    for config in pipeline.build_configs(tree, suitable_stages(overrides)).values():
        for key, value in as_mapping(config).items():
            assert value == tree[key]


def test_the_defaults_in_python_are_what_the_command_runs() -> None:
    tree = tree_of()
    for group in pipeline.GROUPS:
        assert as_mapping(build(pipeline.kind_of(group), {})) == tree[group], group
    for key, value in as_mapping(pipeline.RunConfig()).items():
        assert value == tree[key]
    assert tree.keys() == {*pipeline.GROUPS, pipeline.ROBOT, *as_mapping(pipeline.RunConfig())}


@pytest.mark.parametrize("group", OF_SETTINGS)
def test_every_choice_is_the_same_in_python(group) -> None:
    for choice in choices_of(group):
        assert as_mapping(shipped(pipeline.kind_of(group), f"{group}/{choice}")) == tree_of(f"{group}={choice}")[group]


def test_every_key_of_every_stage_belongs_to_the_run_to_the_robot_or_to_one_group() -> None:
    run_keys = {field.name for field in dataclasses.fields(pipeline.RunConfig)}
    assert not run_keys & pipeline.GROUPS.keys() and {*pipeline.GROUPS.values()} <= pipeline.STAGES.keys()
    found = set()
    for stage in pipeline.STAGES.values():
        for key, kind in get_type_hints(stage.load().Config, include_extras=True).items():
            found.add(key)
            assert key in {*run_keys, pipeline.ROBOT} or kind is pipeline.kind_of(key), (stage.module, key)
    assert found >= pipeline.GROUPS.keys()


def stand_twice(content: dict[str, Any], below: list[Any]) -> list[str]:
    """The keys whose value nothing changes, whichever of `below` it is laid on."""
    return [
        ".".join(place)
        for place, value in leaves(content)
        if place and all(value_at(one, place) == value for one in below)
    ]


@pytest.mark.parametrize("group", OF_SETTINGS)
def test_no_choice_says_what_is_the_default(group) -> None:
    for choice in choices_of(group):
        content = {
            key: value
            for key, value in read_yaml(conf_folder() / group / f"{choice}.yaml").items()
            if key != "defaults"
        }
        assert stand_twice(content, [tree_of()[group]]) == []


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_no_experiment_says_what_is_so_without_it_whatever_else_is_chosen(experiment) -> None:
    content = read_yaml(conf_folder() / "experiment" / f"{experiment}.yaml")
    own = {key.split("/")[-1]: choice for entry in content.pop("defaults", []) for key, choice in entry.items()}
    others = [(group, choice) for group in OF_SETTINGS for choice in choices_of(group)]
    below = [
        tree_of(*(f"{key}={value}" for key, value in ({**own, group: choice}).items())) for group, choice in others
    ]
    assert stand_twice(content, below) == []


def test_a_value_that_stands_twice_is_found() -> None:
    tree = tree_of()
    content = {"sample": {"num_samples": tree["sample"]["num_samples"], "home_share": 0.5}, "seed": 0}
    assert stand_twice(content, [tree]) == ["sample.num_samples", "seed"]
    assert stand_twice(content, [tree, tree | {"seed": 1}]) == ["sample.num_samples"]


def test_a_folder_of_the_shipped_files_is_a_group_of_more_than_one_choice() -> None:
    assert {*OF_SETTINGS} <= pipeline.GROUPS.keys()
    assert all(len(choices_of(group)) > 1 for group in GROUPS)


def test_every_experiment_runs_under_a_name_of_its_own() -> None:
    for name in EXPERIMENTS:
        assert tree_of(f"+experiment={name}")["name"] == name


def test_the_default_stages_are_those_that_are_not_on_demand() -> None:
    assert tree_of()["stages"] == [name for name, stage in pipeline.STAGES.items() if stage.default]


def test_a_run_is_told_only_what_was_said_and_imports_no_stage_to_know_it(monkeypatch) -> None:
    monkeypatch.setattr(pipeline, "kind_of", sys.exit)
    tree = tree_of("sample.num_samples=4096", "policy=paper", "policy.ppo.dagger={rounds: 3}", is_whole=False)
    assert tree["sample"] == {"num_samples": 4096} and tree["track"] == {}
    assert tree["policy"]["ppo"]["dagger"] == {"rounds": 3} and tree["policy"]["num_envs"] == 2048


def test_the_paper_s_policy_trains_in_mjx_where_that_is_the_simulation() -> None:
    configs = pipeline.build_configs(tree_of("+experiment=paper", "policy=paper", "simulation=mjx"))
    config, backend = configs["policy"], configs["robustness"].simulation.backend
    assert (config.engine.kind, config.policy.base, backend) == ("mjx", "learned", "mjx")


@pytest.mark.parametrize("is_whole", [True, False])
@pytest.mark.parametrize(
    ("overrides", "kind"),
    [
        ((), "minimal"),
        (("simulation=mujoco",), "minimal"),
        (("simulation=mjx",), "mjx"),
        (("simulation=mjx_warp",), "mjx-warp"),
        (("engine=mjx",), "mjx"),
        (("engine=minimal", "simulation=mjx"), "minimal"),
        (("simulation=mjx", "engine=minimal"), "minimal"),
    ],
)
def test_what_policies_train_in_follows_the_simulation_unless_it_is_chosen(overrides, kind, is_whole) -> None:
    tree, timestep = tree_of(*overrides, is_whole=is_whole), {"minimal": 0.005, "mjx": 0.004, "mjx-warp": 0.004}[kind]
    engines = [config.engine for config in pipeline.build_configs(tree).values() if hasattr(config, "engine")]
    assert len(engines) == 3  # policy, residual, robustness
    assert {(engine.kind, engine.timestep) for engine in engines} == {(kind, timestep)}
