"""How much volume a finite sample has missed: Chao's estimate from the cells hit once and twice, and its bootstrap interval.

Plainly resampling the sample would be wrong here: a resample loses cells and never finds a new one, so that its
interval lies below what has been seen already. The bootstrap draws from the estimated population, unseen cells included,
and its spread alone is used: its centre inherits the estimate's bias once more.
"""

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class VolumeEstimate:
    """A reachable volume, all in the unit of the cells' volumes."""

    seen: float
    """Of the cells hit: a lower bound."""
    estimate: float
    """With what is expected to be unseen."""
    low: float
    high: float
    """Bootstrap interval of the estimate."""


def estimate_volume(
    counts: np.ndarray, volumes: np.ndarray, seed: int, num_resamples: int, confidence: float
) -> VolumeEstimate:
    """Volume of all cells that can be hit, from the hits of a sample.

    Args:
        counts: (cells,) hits.
        volumes: (cells,).
        num_resamples: of the bootstrap.
        confidence: of the two-sided interval: the resamples' spread about their median, laid around the estimate.
    """
    hit = counts > 0
    counts, volumes = counts[hit].astype(np.float64), volumes[hit]
    num_unseen, each = unseen_cells(counts, volumes)
    random = np.random.default_rng(seed)
    rates = _rates(counts, num_unseen)
    sizes = np.concatenate([volumes, np.full(num_unseen, each)])
    resampled = [_estimate(random.poisson(rates), sizes) for _ in range(num_resamples)]
    shares = [(1.0 - confidence) / 2.0, 0.5, (1.0 + confidence) / 2.0]
    low, middle, high = (float(value) for value in np.quantile(resampled, shares))
    seen, estimate = float(volumes.sum()), _estimate(counts, volumes)
    return VolumeEstimate(seen, estimate, max(estimate + low - middle, seen), estimate + high - middle)


def unseen_cells(counts: np.ndarray, volumes: np.ndarray) -> tuple[int, float]:
    """Number of cells that a sample has probably missed, and the volume of each: that of the cells hit once.

    Source: Chao (1984), bias-corrected: f1 (f1 - 1) / (2 (f2 + 1)), from the cells hit once and twice. Exact in the mean
    where all cells are equally likely, a lower bound elsewhere.
    """
    once, twice = counts == 1, int((counts == 2).sum())
    num_once = int(once.sum())
    each = float(volumes[once].mean()) if num_once else 0.0
    return round(num_once * (num_once - 1) / (2 * (twice + 1))), each


def _estimate(counts: np.ndarray, volumes: np.ndarray) -> float:
    num_unseen, each = unseen_cells(counts, volumes)
    return float(volumes[counts > 0].sum()) + num_unseen * each


def _rates(counts: np.ndarray, num_unseen: int) -> np.ndarray:
    """Expected hits of every cell: those of rarely hit cells shrunk, so that the unseen ones get their share.

    Source: Chao, Hsieh et al. (2015), Ecology 96, 1189-1201: by Good and Turing the unseen cells hold as many hits of
    another sample as there are cells hit once.
    """
    if num_unseen == 0:
        return counts
    num_once = float((counts == 1).sum())
    rare = counts * np.exp(-counts)  # at most 1/e of the count: what is left stays positive
    return np.concatenate([counts - num_once / rare.sum() * rare, np.full(num_unseen, num_once / num_unseen)])
