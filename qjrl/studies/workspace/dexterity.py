"""How many orientations the tip can take where it is: bins of orientation per ring around the base axis.

An arm that looks the same from all sides reaches a place at azimuth psi with R exactly as it reaches azimuth 0 with
Rz(-psi) R Rz(psi): orientations are therefore binned as those of the meridian plane at azimuth 0.
"""

import dataclasses
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.config import Range, configuration
from qjrl.studies.workspace.occupancy import RingGrid


@configuration
class OrientationBins:
    """Bins of equal volume in SO(3): R = Rz(a) Ry(t) Rz(-a) Rz(s), even in a, cos t and s."""

    tilts: Annotated[int, Range(1, 64)] = 6
    """Bands of the tip axis' tilt t from the base axis, equal in cos t."""
    azimuths: Annotated[int, Range(1, 128)] = 12
    """Sectors of the direction a in which it tilts, from the outward direction of the place."""
    spins: Annotated[int, Range(1, 128)] = 8
    """Sectors of the spin s about the tip axis."""

    @property
    def num_directions(self) -> int:
        return self.tilts * self.azimuths

    @property
    def num_bins(self) -> int:
        return self.num_directions * self.spins


@configuration
class DexterityGrid:
    """Places that are pairs of a ring and an orientation bin."""

    rings: RingGrid
    bins: OrientationBins

    needs_pose = True

    @property
    def num_places(self) -> int:
        return self.rings.num_places * self.bins.num_bins

    def __call__(self, pose: jax.Array) -> jax.Array:
        """Number of the pair for a pose (9,) [m, -]."""
        return self.rings(pose[:3]) * self.bins.num_bins + orientation_bin(pose, self.bins)


@dataclasses.dataclass(frozen=True)
class Dexterity:
    """Shares of orientations reached, by ring; NaN where the tip never was."""

    directions: np.ndarray
    """(along z, along rho) share of the directions in which the tip axis can point."""
    orientations: np.ndarray
    """(along z, along rho) share of all orientations, spin included."""


def orientation_bin(pose: jax.Array, bins: OrientationBins) -> jax.Array:
    """Number of the orientation bin of a pose (9,): (tilt, azimuth, spin) in row-major order."""
    x, y = pose[3:6], pose[6:9]
    axis_x, axis_y = x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2]
    cosine = x[0] * y[1] - x[1] * y[0]
    azimuth = jnp.arctan2(axis_y, axis_x)
    around = azimuth - jnp.arctan2(pose[1], pose[0])
    spin = jnp.arctan2(y[2], -x[2]) + azimuth  # Euler angles z-y-z: R[2, :2] = sin t (-cos(s - a), sin(s - a))
    tilt = jnp.clip(jnp.floor((1.0 - cosine) / 2.0 * bins.tilts).astype(jnp.int32), 0, bins.tilts - 1)
    return (tilt * bins.azimuths + _sector(around, bins.azimuths)) * bins.spins + _sector(spin, bins.spins)


def dexterity(hits: np.ndarray, grid: DexterityGrid) -> Dexterity:
    """Shares from the hits (num_places,) of a grid."""
    reached = (hits > 0).reshape(*grid.rings.shape, grid.bins.num_directions, grid.bins.spins)
    empty = ~reached.any(axis=(2, 3))
    directions, orientations = reached.any(axis=3).mean(axis=2), reached.mean(axis=(2, 3))
    return Dexterity(np.where(empty, np.nan, directions), np.where(empty, np.nan, orientations))


def mean_over_volume(share: np.ndarray, volumes: np.ndarray, is_counted: np.ndarray) -> float:
    """Mean of a share over the volume of the rings counted; rings that were never reached count as zero."""
    weights = np.where(is_counted, volumes, 0.0)
    return float((np.where(np.isnan(share), 0.0, share) * weights).sum() / weights.sum())


def _sector(angle: jax.Array, num_sectors: int) -> jax.Array:
    """Number of the sector of an angle [rad] of any number of turns; a sector is centred at angle 0."""
    turns = angle / (2.0 * jnp.pi) + 0.5 / num_sectors
    return jnp.clip(jnp.floor((turns - jnp.floor(turns)) * num_sectors).astype(jnp.int32), 0, num_sectors - 1)
