"""Workspaces of arms whose reach is known, and the stage on two small ones."""

import base64
import dataclasses
import json
import re
from typing import Any

import jax
import numpy as np
import pytest
import yaml
from arms import altered

from qjrl import artifacts, pipeline
from qjrl.config import as_mapping, read_yaml
from qjrl.robot import load_robot
from qjrl.studies.workspace.cloud_viewer import Cloud, cloud_viewer
from qjrl.studies.workspace.comparison import compare, evaluate, parts_of
from qjrl.studies.workspace.dexterity import OrientationBins
from qjrl.studies.workspace.stage import Config
from qjrl.studies.workspace.survey import ArmConfig, WorkspaceConfig, measure_workspaces
from qjrl.studies.workspace.tip_clouds import BATCH, LAWS, count_hits, draw_tips

LINK = 0.1
LIMIT = 60.0


@pytest.fixture(scope="module")
def two_links(tmp_path_factory) -> str:
    """Two links of 100 mm on joints without height: a body of revolution whose volume is an integral."""
    mapping = altered("qj_22", joints_per_segment=[1, 1], link_length=LINK, joint__crossed_link_length=1e-6)
    mapping["joint"] |= {"pin_distance": 0.0, "plate_to_pin": 0.0, "bend_limit_deg": LIMIT}
    mapping["cables"]["hole_circle_diameter"] = 1e-7
    path = tmp_path_factory.mktemp("robots") / "two_links.yaml"
    path.write_text(yaml.safe_dump(mapping))
    return str(path)


@pytest.fixture(scope="module")
def config(two_links) -> WorkspaceConfig:
    arms = (
        ArmConfig("two links", two_links, LIMIT, is_reference=False),
        ArmConfig("half the bend", two_links, LIMIT / 2, is_reference=True),
    )
    return WorkspaceConfig(
        arms, num_samples=BATCH, num_oriented=BATCH, cell=0.0025, coarse_factor=2, bins=OrientationBins(2, 4, 2), num_resamples=50,
        num_drawn=200,
    )  # fmt: skip


@pytest.fixture(scope="module")
def workspaces(config):
    return measure_workspaces(config, 0, lambda count: None)


def two_link_volume(limit: float) -> float:
    """Tips lie 2 L cos(t/2) from the base, up to limit + t/2 off its axis, for the second bend t from 0 to the limit."""
    angle = np.linspace(0.0, limit, 20_001)
    radius, tilt = 2.0 * LINK * np.cos(angle / 2.0), limit + angle / 2.0
    return float(np.trapezoid(2.0 * np.pi * (1.0 - np.cos(tilt)) * radius**2 * LINK * np.sin(angle / 2.0), angle))


def test_the_volume_of_two_links_is_its_integral(workspaces):
    for one in workspaces:
        limit = np.radians(one.config.bend_limit_deg)
        true = two_link_volume(float(limit))
        assert one.volume.seen > true  # cells that the boundary cuts count as full
        assert one.limit_volume == pytest.approx(true, rel=0.03)
        assert one.voxels.inside < true < one.voxels.hit <= one.voxels.touched
        assert one.voxels.hit_outside == 0


def test_one_joint_reaches_a_surface_whose_volume_vanishes_with_the_cells(two_links, tmp_path):
    mapping: dict[str, Any] = read_yaml(two_links) | {"joints_per_segment": [1]}
    mapping["cables"] = mapping["cables"] | {"hole_angles_deg": [[0, 90]], "names": [[1, 2]]}
    (tmp_path / "one.yaml").write_text(yaml.safe_dump(mapping))
    tips = draw_tips(load_robot(tmp_path / "one.yaml"), "spatial", jax.random.key(0), 1000)
    np.testing.assert_allclose(np.linalg.norm(tips, axis=1), LINK, atol=2e-6)  # the cap of a sphere ...
    assert tips[:, 2].min() == pytest.approx(LINK * np.cos(np.radians(LIMIT)), rel=0.01)  # ... down to its rim


def test_planar_bends_reach_all_that_spatial_bends_reach(workspaces):
    for one in workspaces:
        only_spatial = (one.hits["spatial"] > 0) & (one.hits["planar"] == 0)
        assert one.rings.volume(only_spatial) < 0.002 * one.volume.seen


def test_an_arm_overlaps_with_itself_and_holds_the_one_that_bends_less(workspaces, config):
    itself = dataclasses.replace(
        workspaces[0], config=dataclasses.replace(config.arms[0], label="the same", is_reference=True)
    )
    same, less = compare([workspaces[0], itself, workspaces[1]], config.comparable_share)
    assert same.overlap.of_first == same.overlap.of_second == same.volume_ratio == 1.0 and same.is_comparable
    assert less.overlap.of_second > 0.98 and less.overlap.of_first < 0.6 and less.volume_ratio > 1.6
    verdict = evaluate([same, less], config.comparable_share)
    assert verdict.holds is True and "comparable with the same and half the bend" in verdict.headline
    reversed_pair = dataclasses.replace(less, is_comparable=False)
    assert evaluate([same, reversed_pair], 0.9).holds is None and evaluate([reversed_pair], 0.9).holds is False


def test_volumes_seen_grow_with_the_samples(workspaces):
    for one in workspaces:
        for law in ("spatial", "planar"):
            seen = [row[law] for row in one.convergence]
            assert seen == sorted(seen) and seen[-1] <= one.volume.seen


def test_the_paper_counts_parts_as_we_do(workspaces):
    huang = dataclasses.replace(workspaces[0], robot=load_robot("qj_huang_4332"))
    parts = parts_of(huang)
    assert (parts["joints"], parts["motors"], parts["strands"]) == (12, 8, 16)
    assert parts["strand_passages"] == 4 * (4 + 7 + 10 + 12)


@pytest.mark.parametrize("law", ["spatial", "planar"])
def test_bends_keep_the_limit_and_the_plane(law):
    robot = load_robot("qj_2222")
    words = np.random.default_rng(0).integers(0, 1 << 32, (2000, 4), dtype=np.uint32)
    bends = np.asarray(jax.vmap(lambda row: LAWS[law](robot, row))(words), np.float64)
    sizes, limit = np.linalg.norm(bends, axis=2), np.sin(float(robot.bend_limit) / 2)
    assert 0.999 * limit < sizes.max() <= limit * (1 + 1e-6)
    across = bends[:, 0, 0] * bends[:, 3, 1] - bends[:, 0, 1] * bends[:, 3, 0]
    assert (np.abs(across).max() < 1e-6) == (law == "planar")
    azimuths = np.arctan2(bends[:, 0, 1], bends[:, 0, 0])
    assert np.histogram(azimuths, 8, (-np.pi, np.pi))[0].min() > 180  # 250 each


def test_samples_are_counted_once_and_repeatably(workspaces):
    one = workspaces[0]
    runs = [
        np.sum(
            [new for _, new in count_hits(one.robot, "spatial", one.rings, jax.random.key(3), BATCH + 50_000)], axis=0
        )
        for _ in range(2)
    ]
    assert runs[0].sum() == BATCH + 50_000
    np.testing.assert_array_equal(runs[0], runs[1])


def test_the_viewer_holds_the_points_and_nothing_from_elsewhere():
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    page = cloud_viewer([Cloud("<mine>", points, "blue")]).html
    found = re.search(r'<script type="application/json">(.*?)</script>', page)
    assert found
    data = json.loads(found[1])
    decoded = np.frombuffer(base64.b64decode(data["clouds"][0]["points"]), "<i2").reshape(-1, 3)
    np.testing.assert_allclose(decoded * 0.1 / data["axis"], points, atol=1e-4)
    assert "&lt;mine&gt;" in page and "http" not in page and "src=" not in page
    with pytest.raises(ValueError, match="colour: got 'pink'"):
        Cloud("x", points, "pink")


def test_another_description_under_the_same_name_is_another_stage(config, two_links, tmp_path):
    copy = tmp_path / "arm.yaml"
    changed = read_yaml(two_links)
    hashes = set()
    for length in (LINK, 1.5 * LINK, LINK):
        copy.write_text(yaml.safe_dump(changed | {"link_length": length}))
        arms = tuple(dataclasses.replace(arm, robot=str(copy)) for arm in config.arms)
        hashes.add(Config(dataclasses.replace(config, arms=arms), seed=0).robot_hash)
    assert len(hashes) == 2


def test_the_stage_writes_metrics_figures_and_a_page_of_its_own(config, tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "STAGES", {"workspace": pipeline.STAGES["workspace"]})
    tree = {"name": "tiny", "seed": 0, "stages": ["workspace"], "workspace": as_mapping(config)}
    pipeline.run(pipeline.selected(tree), pipeline.build_configs(tree), tmp_path)
    metrics = artifacts.load(tmp_path / "workspace" / "metrics.json")
    assert metrics["arms"].keys() == {arm.label for arm in config.arms} and len(metrics["pairs"]) == 1
    assert metrics["arms"]["two links"]["poses_per_second"] > 0
    page = (tmp_path / "workspace" / "report.html").read_text()
    assert metrics["verdict"]["headline"] in page and "<canvas" in page
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    names = {path.stem for path in (tmp_path / "workspace").glob("*.png")}
    assert names == {"sections", "clouds-half-the-bend", "convergence", "dexterity"}


def test_arms_need_both_roles_and_different_labels(two_links):
    arm = ArmConfig("a", two_links, LIMIT, is_reference=False)
    with pytest.raises(ValueError, match="is_reference"):
        WorkspaceConfig((arm, arm))
    with pytest.raises(ValueError, match="all different"):
        WorkspaceConfig((arm, dataclasses.replace(arm, is_reference=True)))
