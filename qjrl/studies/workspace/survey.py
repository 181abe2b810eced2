"""The workspace of an arm: rings and voxels that its tip reaches, how sure that is, and in how many orientations."""

import dataclasses
import time
from collections.abc import Callable
from typing import Annotated

import jax
import numpy as np

from qjrl.config import Range, as_mapping, configuration
from qjrl.robot import load_robot, robot_from_mapping
from qjrl.robot.verbs import Robot
from qjrl.studies.workspace.dexterity import Dexterity, DexterityGrid, OrientationBins, dexterity
from qjrl.studies.workspace.occupancy import RingGrid, VoxelGrid, extrapolated, ring_grid
from qjrl.studies.workspace.tip_clouds import BATCH, LAWS, count_hits, draw_tips
from qjrl.studies.workspace.unseen import VolumeEstimate, estimate_volume
from qjrl.studies.workspace.voxel_check import VoxelCheck, check_voxels


@configuration
class ArmConfig:
    """One arm whose workspace is measured."""

    label: str
    """As shown."""
    robot: str
    """Shipped name or path of a YAML file."""
    bend_limit_deg: Annotated[float, Range(above=0.0, below=90.0)]
    """Largest bend angle of a joint, in place of the description's [deg]."""
    is_reference: bool
    """Whether the other arms are compared with it."""


@configuration
class WorkspaceConfig:
    """Group `workspace`."""

    arms: tuple[ArmConfig, ...] = (
        ArmConfig("paper ±40°", "qj_2222", 40.0, is_reference=False),
        ArmConfig("paper ±70°", "qj_2222", 70.0, is_reference=False),
        ArmConfig("Huang, equal joints", "qj_huang_4332", 40.0, is_reference=True),
        ArmConfig("Huang, equal length", "qj_huang_4332_480", 40.0, is_reference=True),
    )
    """Those that are measured; each that is no reference is compared with each that is."""
    num_samples: Annotated[int, Range(1000, 10_000_000_000)] = 16_000_000
    """Poses by each law for the rings, and for the voxels (ours)."""
    num_oriented: Annotated[int, Range(1000, 10_000_000_000)] = 48_000_000
    """Poses by the spatial law for the orientations: five dimensions fill more slowly (ours)."""
    cell: Annotated[float, Range(low=1e-3, high=0.2)] = 0.005
    """Width of a ring in rho and z [m] (ours)."""
    coarse_factor: Annotated[int, Range(2, 32)] = 4
    """Width of the cells of voxels and orientations, in rings (ours)."""
    bins: OrientationBins = OrientationBins()
    """Orientation bins of a cell (ours)."""
    num_resamples: Annotated[int, Range(50, 100_000)] = 1000
    """Of the bootstrap (ours)."""
    confidence: Annotated[float, Range(above=0.5, below=1.0)] = 0.95
    """Of the bootstrap's interval (ours)."""
    comparable_share: Annotated[float, Range(above=0.0, high=1.0)] = 0.9
    """An arm's workspace is comparable with a reference when it reaches this share of the reference's volume (ours)."""
    num_drawn: Annotated[int, Range(100, 200_000)] = 10_000
    """Tips in the pictures of an arm."""

    def __post_init__(self):
        roles = {arm.is_reference for arm in self.arms}
        if roles != {True, False}:
            raise ValueError("arms: got all with one value of is_reference, allowed: at least one true and one false")
        labels = [arm.label for arm in self.arms]
        if len(set(labels)) != len(labels):
            raise ValueError(f"arms: got the labels {labels}, allowed: all different")


@dataclasses.dataclass(frozen=True)
class ArmWorkspace:
    """What was measured of one arm."""

    config: ArmConfig
    robot: Robot
    rings: RingGrid
    hits: dict[str, np.ndarray]
    """Law -> hits of the rings (along z, along rho)."""
    convergence: list[dict[str, float]]
    """Volume seen [m^3] by each law after so many samples of it."""
    volume: VolumeEstimate
    """[m^3], both laws together."""
    limit_volume: float
    """[m^3] extrapolated to vanishing cells."""
    voxels: VoxelCheck
    dexterity: Dexterity
    half_dexterity: Dexterity
    """After half of the samples: what is still growing."""
    tips: np.ndarray
    """(num_drawn, 3) [m] by the spatial law."""
    poses_per_second: float
    """Drawn, carried to the tip and counted, both laws of the rings."""

    @property
    def is_reached(self) -> np.ndarray:
        """(along z, along rho) rings hit by any law."""
        return np.stack(list(self.hits.values())).any(axis=0)


def robot_of(config: ArmConfig) -> Robot:
    """The arm with its bend limit replaced."""
    mapping = as_mapping(load_robot(config.robot).config)
    return robot_from_mapping(mapping | {"joint": mapping["joint"] | {"bend_limit_deg": config.bend_limit_deg}})


def reach_bound(robot: Robot) -> float:
    """A distance from the base [m] that no tip exceeds: links and joints in line, each joint at the bound l + 2 d of H."""
    joint = robot.config.joint
    return robot.num_joints * (joint.crossed_link_length + 2.0 * joint.plate_to_pin + robot.config.link_length)


def measure_workspaces(config: WorkspaceConfig, seed: int, advance: Callable[[int], None]) -> list[ArmWorkspace]:
    """All arms on one grid.

    Args:
        advance: called with the number of poses drawn.
    """
    robots = [robot_of(arm) for arm in config.arms]
    rings = ring_grid(max(map(reach_bound, robots)), config.cell, config.coarse_factor)
    keys = jax.random.split(jax.random.key(seed), len(robots))
    return [
        _measure(config, arm, robot, rings, key, advance)
        for arm, robot, key in zip(config.arms, robots, keys, strict=True)
    ]


def num_poses(config: WorkspaceConfig) -> int:
    """Poses that `measure_workspaces` draws."""
    return len(config.arms) * (config.num_samples * (len(LAWS) + 1) + config.num_oriented)


def _measure(config: WorkspaceConfig, arm: ArmConfig, robot: Robot, rings: RingGrid, key, advance) -> ArmWorkspace:
    key_rings, key_voxels, key_orientations, key_tips = jax.random.split(key, 4)
    hits, convergence, rate = _ring_hits(robot, rings, key_rings, config.num_samples, advance)
    together = np.stack(list(hits.values())).sum(axis=0)
    coarse = rings.coarser(config.coarse_factor)
    voxels = VoxelGrid(coarse.cell, coarse.num_cells)
    voxel_hits = np.zeros(voxels.num_places, np.int64)
    for size, new in count_hits(robot, "planar", voxels, key_voxels, config.num_samples):
        voxel_hits += new
        advance(size)
    half, whole = _dexterities(
        robot, DexterityGrid(coarse, config.bins), key_orientations, config.num_oriented, advance
    )
    seed = int(jax.random.key_data(key)[-1])
    volume = estimate_volume(together.ravel(), rings.volumes.ravel(), seed, config.num_resamples, config.confidence)
    twice = rings.coarser(2).volume(rings.merged(together, 2) > 0)
    return ArmWorkspace(
        config=arm, robot=robot, rings=rings, hits=hits, convergence=convergence, volume=volume,
        limit_volume=extrapolated(volume.estimate, twice), voxels=check_voxels(voxel_hits, voxels, together > 0, rings),
        dexterity=whole, half_dexterity=half, tips=draw_tips(robot, "spatial", key_tips, config.num_drawn),
        poses_per_second=rate,
    )  # fmt: skip


def _ring_hits(robot: Robot, rings: RingGrid, key, num_samples: int, advance):
    """Hits by law, the volumes seen at a quarter of the samples and so on, and poses a second (without the compilation)."""
    checkpoints = [num_samples // 4**step for step in reversed(range(4))]
    hits, seen, seconds = {}, {}, 0.0
    for law, law_key in zip(LAWS, jax.random.split(key, len(LAWS)), strict=True):
        next(count_hits(robot, law, rings, jax.random.fold_in(law_key, 1 << 30), min(num_samples, BATCH)))  # compile
        counts, drawn, seen[law], start = np.zeros(rings.num_places, np.int64), 0, [], time.perf_counter()
        for size, new in count_hits(robot, law, rings, law_key, num_samples):
            counts, drawn = counts + new, drawn + size
            while len(seen[law]) < len(checkpoints) and drawn >= checkpoints[len(seen[law])]:
                seen[law].append((drawn, rings.volume(counts > 0)))
            advance(size)
        seconds += time.perf_counter() - start
        hits[law] = counts.reshape(rings.shape)
    rows = [{"samples": points[0][0]} | dict(zip(LAWS, (volume for _, volume in points), strict=True))
            for points in zip(*seen.values(), strict=True)]  # fmt: skip
    return hits, rows, len(LAWS) * num_samples / seconds


def _dexterities(robot: Robot, grid: DexterityGrid, key, num_samples: int, advance) -> tuple[Dexterity, Dexterity]:
    """After half of the samples and after all."""
    hits, drawn, half = np.zeros(grid.num_places, np.int32), 0, None
    for size, new in count_hits(robot, "spatial", grid, key, num_samples):
        hits, drawn = hits + new.astype(np.int32), drawn + size
        if half is None and 2 * drawn >= num_samples:
            half = dexterity(hits, grid)
        advance(size)
    whole = dexterity(hits, grid)
    return half or whole, whole
