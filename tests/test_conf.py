"""The shipped values: every choice of every group builds, and the files say what the dataclasses say."""

from collections.abc import Iterator
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from qjrl import pipeline
from qjrl.config import as_mapping, conf_folder


def choices() -> Iterator[str]:
    for path in sorted(conf_folder().glob("*/*.yaml")):
        yield f"{'+' if path.parent.name == 'experiment' else ''}{path.parent.name}={path.stem}"


def tree_of(*overrides: str) -> dict[str, Any]:
    with initialize_config_dir(version_base=None, config_dir=str(conf_folder())):
        tree = OmegaConf.to_container(compose("config", list(overrides)), resolve=True)
    assert isinstance(tree, dict)
    return {str(key): value for key, value in tree.items()}


@pytest.mark.parametrize("choice", choices())
def test_every_shipped_choice_builds(choice) -> None:
    configs = pipeline.build_configs(tree_of(choice))
    assert configs.keys() == pipeline.STAGES.keys()


def test_every_experiment_runs_under_a_name_of_its_own() -> None:
    for path in (conf_folder() / "experiment").glob("*.yaml"):
        assert tree_of(f"+experiment={path.stem}")["name"] == path.stem


def test_the_default_stages_are_those_that_are_not_on_demand() -> None:
    assert tree_of()["stages"] == [name for name, stage in pipeline.STAGES.items() if stage.default]


def test_the_paper_s_policy_trains_in_mjx_where_that_is_the_simulation() -> None:
    configs = pipeline.build_configs(tree_of("+experiment=paper", "policy=paper", "simulation=mjx"))
    config, backend = configs["policy"], configs["robustness"].simulation.backend
    assert (config.engine.kind, config.policy.base, backend) == ("mjx", "learned", "mjx")


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
def test_what_policies_train_in_follows_the_simulation_unless_it_is_chosen(overrides, kind) -> None:
    tree, timestep = tree_of(*overrides), {"minimal": 0.005, "mjx": 0.004, "mjx-warp": 0.004}[kind]
    engines = [config.engine for config in pipeline.build_configs(tree).values() if hasattr(config, "engine")]
    assert len(engines) == 3  # policy, residual, robustness
    assert {(engine.kind, engine.timestep) for engine in engines} == {(kind, timestep)}


@pytest.mark.parametrize("choice", [choice for choice in choices() if "experiment" not in choice])
def test_the_files_show_every_value_that_there_is(choice) -> None:
    tree = tree_of(choice)
    for config in pipeline.build_configs(tree).values():
        for key, value in as_mapping(config).items():
            assert value == tree[key]
