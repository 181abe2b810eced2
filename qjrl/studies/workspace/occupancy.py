"""Which cells around the base a cloud of tips hits: rings in (rho, z) whose volume is that of their revolution, and voxels."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np


@dataclasses.dataclass(frozen=True)
class RingGrid:
    """Square cells in (rho, z), rho up to and z from minus to plus `num_cells * cell`; each stands for a ring."""

    cell: float
    """Width of a cell [m]."""
    num_cells: int
    """Across the radius."""

    needs_pose = False

    @property
    def shape(self) -> tuple[int, int]:
        """(along z, along rho)."""
        return 2 * self.num_cells, self.num_cells

    @property
    def num_places(self) -> int:
        return self.shape[0] * self.shape[1]

    def __call__(self, position: jax.Array) -> jax.Array:
        """Number of the ring that holds a position (3,) [m]."""
        rho = jnp.sqrt(position[0] * position[0] + position[1] * position[1])
        column = _clipped(rho / self.cell, self.num_cells)
        return _clipped(position[2] / self.cell + self.num_cells, 2 * self.num_cells) * self.num_cells + column

    @property
    def volumes(self) -> np.ndarray:
        """(along z, along rho) volume of each ring [m^3]: pi h ((r + h)^2 - r^2)."""
        inner = np.arange(self.num_cells)
        return np.broadcast_to(np.pi * self.cell**3 * (2 * inner + 1), self.shape)

    def volume(self, is_occupied: np.ndarray) -> float:
        """Volume of the revolution of the occupied cells [m^3]."""
        return float(self.volumes[is_occupied.reshape(self.shape)].sum())

    def coarser(self, factor: int) -> "RingGrid":
        """The grid whose cells hold factor x factor of these."""
        if self.num_cells % factor:
            raise ValueError(f"factor: got {factor}, allowed: a divisor of {self.num_cells}")
        return RingGrid(self.cell * factor, self.num_cells // factor)

    def merged(self, counts: np.ndarray, factor: int) -> np.ndarray:
        """Counts of this grid on the coarser one."""
        rows, columns = self.coarser(factor).shape
        return counts.reshape(rows, factor, columns, factor).sum(axis=(1, 3))


@dataclasses.dataclass(frozen=True)
class VoxelGrid:
    """Cubes around the base: the count that the rings are checked against; it knows of no symmetry."""

    cell: float
    """Edge of a voxel [m]."""
    num_cells: int
    """From the base to each side."""

    needs_pose = False

    @property
    def num_places(self) -> int:
        return (2 * self.num_cells) ** 3

    def __call__(self, position: jax.Array) -> jax.Array:
        """Number of the voxel that holds a position (3,) [m]."""
        side = 2 * self.num_cells
        x, y, z = (_clipped(position[axis] / self.cell + self.num_cells, side) for axis in range(3))
        return (z * side + y) * side + x

    def volume(self, is_occupied: np.ndarray) -> float:
        """Volume of the occupied voxels [m^3]."""
        return float(is_occupied.sum() * self.cell**3)


def ring_grid(reach: float, cell: float, factor: int) -> RingGrid:
    """The smallest grid that holds all tips within `reach` [m] of the base, a multiple of `factor` cells wide."""
    return RingGrid(cell, factor * int(np.ceil(reach / (factor * cell) + 1e-6)))


def extrapolated(fine: float, coarse: float) -> float:
    """Volume for ever smaller cells from those of cells h and 2 h.

    Cells that the boundary cuts count as full, an excess of the boundary's area times a share of h: linear in h.
    """
    return 2.0 * fine - coarse


@dataclasses.dataclass(frozen=True)
class Overlap:
    """What two reachable sets share."""

    shared: float
    """Volume of the intersection [m^3]."""
    of_first: float
    """Share of the first set that the second reaches too."""
    of_second: float
    """Share of the second set that the first reaches too."""
    jaccard: float
    """Intersection over union."""


def overlap(first: np.ndarray, second: np.ndarray, volumes: np.ndarray) -> Overlap:
    """Overlap of two sets of occupied cells (cells,) of one grid with these volumes."""
    own, other, shared, either = (
        float(volumes[cells].sum()) for cells in (first, second, first & second, first | second)
    )
    if own == 0.0 or other == 0.0:
        raise ValueError("overlap: got an empty set, allowed: sets with an occupied cell")
    return Overlap(shared, shared / own, shared / other, shared / either)


def _clipped(cells: jax.Array, num_cells: int) -> jax.Array:
    """Number of a cell; what lies beyond the grid falls into its outermost cells."""
    return jnp.clip(jnp.floor(cells).astype(jnp.int32), 0, num_cells - 1)
