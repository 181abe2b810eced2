"""Rings against voxels: what the revolution of the rings promises, counted in a grid that knows of no symmetry."""

import dataclasses

import numpy as np

from qjrl.studies.workspace.occupancy import RingGrid, VoxelGrid


@dataclasses.dataclass(frozen=True)
class VoxelCheck:
    """Volumes [m^3] and counts of voxels."""

    hit: float
    """Of the voxels hit."""
    inside: float
    """Of the voxels that lie wholly in the revolved rings, and ..."""
    touched: float
    """... of those that the revolved rings touch: the true volume lies between the two."""
    missed_inside: int
    """Voxels wholly inside that were never hit."""
    hit_outside: int
    """Voxels hit that no occupied ring touches."""


def check_voxels(hits: np.ndarray, voxels: VoxelGrid, is_reached: np.ndarray, rings: RingGrid) -> VoxelCheck:
    """Compare voxels hit with occupied rings.

    Args:
        hits: (num_places,) of the voxels.
        is_reached: (along z, along rho) of rings whose width divides the voxels'.
    """
    inside, touched = (_voxels_with(rule, voxels, is_reached, rings) for rule in ("all", "any"))
    hit = hits.reshape(inside.shape) > 0
    cube = voxels.cell**3
    return VoxelCheck(
        hit=float(hit.sum() * cube),
        inside=float(inside.sum() * cube),
        touched=float(touched.sum() * cube),
        missed_inside=int((inside & ~hit).sum()),
        hit_outside=int((hit & ~touched).sum()),
    )


def _voxels_with(rule: str, voxels: VoxelGrid, is_reached: np.ndarray, rings: RingGrid) -> np.ndarray:
    """(z, y, x) whether all, or any, of the rings that cross a voxel are occupied."""
    factor = round(voxels.cell / rings.cell)
    slabs = is_reached.reshape(2 * voxels.num_cells, factor, rings.num_cells)
    columns = slabs.all(axis=1) if rule == "all" else slabs.any(axis=1)
    counts = np.concatenate([np.zeros((len(columns), 1), int), np.cumsum(columns, axis=1)], axis=1)
    first, last = _radii(voxels, rings)
    occupied = counts[:, last + 1] - counts[:, first]  # (z, y, x)
    return occupied == last - first + 1 if rule == "all" else occupied > 0


def _radii(voxels: VoxelGrid, rings: RingGrid) -> tuple[np.ndarray, np.ndarray]:
    """(y, x) first and last ring that crosses the voxels over a square of the ground."""
    edges = np.arange(-voxels.num_cells, voxels.num_cells + 1) * voxels.cell
    near = np.maximum(np.maximum(edges[:-1], -edges[1:]), 0.0)
    far = np.maximum(np.abs(edges[:-1]), np.abs(edges[1:]))
    bounds = (np.hypot(*np.meshgrid(side, side)) / rings.cell for side in (near, far))
    first, last = (np.minimum(bound.astype(int), rings.num_cells - 1) for bound in bounds)
    return first, last
