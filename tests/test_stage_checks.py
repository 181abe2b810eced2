"""What the stages refuse before any work, and that it stops those only who ask for them."""

import pytest
from test_conf import tree_of

from qjrl import pipeline
from qjrl.config import ConfigError

EVALUATED = ("compare", "robustness", "deploy")
TRAINED = ("policy", "residual")
ARM = "{{label: {0}, robot: {0}, bend_limit_deg: 40.0, is_reference: {1}}}"


@pytest.mark.parametrize(
    ("override", "refused", "key"),
    [
        ("engine.timestep=0.003", TRAINED, r"policy\.environment\.control_period: got 0.02 s"),
        ("simulation.timestep=0.003", EVALUATED, r"policy\.environment\.control_period: got 0.02 s"),
        ("simulation.timestep=0.003", ("track",), r"track\.period: got 0.02 s"),
        (
            "policy.environment.control_period=0.018",
            (*TRAINED, *EVALUATED),
            r"policy\.environment\.control_period: got",
        ),
        ("track.path=nowhere.csv", ("track",), r"track\.path: nowhere\.csv: cannot be read"),
        ("pretension.path=nowhere.csv", ("pretension",), r"nowhere\.csv"),
        ("deploy.replay=nowhere.npz", ("deploy",), r"deploy\.replay: nowhere\.npz does not exist"),
        (
            f"workspace.arms=[{ARM.format('qj_22', 'true')},{ARM.format('nowhere.yaml', 'false')}]",
            ("workspace",),
            "nowhere",
        ),
    ],
)
def test_a_combination_and_a_file_stop_only_the_stages_that_use_them(override, refused, key) -> None:
    others = [name for name in pipeline.STAGES if name not in refused]
    if override.startswith("simulation"):
        others = [name for name in others if name not in (*EVALUATED, "track")]
    tree = tree_of(override)
    pipeline.build_configs(tree, others)
    for name in refused:
        for stages in ([name], ["sample", name]):
            with pytest.raises(ConfigError, match=key):
                pipeline.build_configs(tree, stages)


@pytest.mark.parametrize(
    ("stage", "need"),
    [("policy", "build_mjcf"), ("compare", "build_mjcf"), ("export", "interface"), ("pretension", "at_pretension")],
)
def test_a_kind_of_robot_stops_only_the_stages_that_need_more_than_it_offers(stage, need) -> None:
    tree = tree_of("robot=continuum_4")
    able = ["sample", "forward_model", "ik"]
    pipeline.build_configs(tree, ["describe", *able])
    message = rf"^robot: got the kind continuum_arm, which offers no {need}, allowed: one that does, for stage {stage}"
    with pytest.raises(ConfigError, match=message + r"; run stages=\[sample,forward_model,ik\]$"):
        pipeline.build_configs(tree, [*able, stage])
    with pytest.raises(ConfigError, match=message + "$"):
        pipeline.build_configs(tree, [stage])


def test_a_value_that_no_stage_allows_stops_all() -> None:
    for override in ("track.speed=-1", "policy.num_envs=x", "robot.link_length=-1", "+workspace.new=1"):
        tree = tree_of(override)
        for name in ("describe", "workspace", "sample"):
            with pytest.raises(ConfigError):
                pipeline.build_configs(tree, [name])


def test_arms_that_the_devices_cannot_share_are_refused_before_any_work(monkeypatch) -> None:
    monkeypatch.setattr("jax.device_count", lambda: 3)
    with pytest.raises(ConfigError, match=r"^policy\.num_envs: got 512, allowed: a multiple of the 3 devices"):
        pipeline.build_configs(tree_of(), ["sample", "policy"])
    pipeline.build_configs(tree_of(), ["sample", "compare"])


def test_every_stage_that_refuses_a_combination_does_so_in_check_and_stops_no_other() -> None:
    """`__post_init__` of a stage's Config would run for every stage, asked for or not."""
    for stage in pipeline.STAGES.values():
        assert "__post_init__" not in vars(stage.load().Config), stage.module
