"""What a sample has missed, where the truth is known."""

import numpy as np
import pytest

from qjrl.studies.workspace.unseen import estimate_volume, unseen_cells

EQUAL = np.full(2000, 3.0)
MIXED = np.geomspace(2.0, 60.0, 2000)
VOLUMES = np.linspace(1.0, 3.0, 2000)


@pytest.mark.parametrize("rates", [EQUAL, MIXED], ids=["equal", "mixed"])
def test_the_bootstrap_interval_covers_the_truth_where_the_plain_count_does_not(rates):
    covered = 0
    for seed in range(40):
        counts = np.random.default_rng(seed).poisson(rates)
        found = estimate_volume(counts, VOLUMES, seed, 200, 0.95)
        assert found.seen < VOLUMES.sum()
        assert found.seen <= found.low <= found.estimate <= found.high
        covered += found.low <= VOLUMES.sum() <= found.high
    assert covered >= 34  # 38 expected; 34 or fewer has a probability below 3 %


def test_the_number_of_unseen_cells_is_right_in_the_mean():
    counts = [np.random.default_rng(seed).poisson(EQUAL) for seed in range(40)]
    estimated = np.mean([unseen_cells(one[one > 0], VOLUMES[one > 0])[0] for one in counts])
    assert estimated == pytest.approx(len(EQUAL) * np.exp(-3.0), rel=0.05)


def test_a_saturated_sample_misses_nothing():
    found = estimate_volume(np.full(50, 1000), np.ones(50), 0, 100, 0.95)
    assert found.seen == found.estimate == found.low == found.high == 50.0
