import itertools

import jax
import numpy as np
import pytest

from qjrl.keys import PURPOSES, key_for, number_of, seed_for


def bits(key):
    return tuple(np.asarray(jax.random.key_data(key)).tolist())


def test_every_purpose_has_a_number_of_its_own():
    numbers = [number_of(purpose) for purpose in PURPOSES]
    assert len(set(numbers)) == len(PURPOSES)
    assert min(numbers) > 1 << 24  # above the number of any arm or row


def test_streams_of_all_purposes_and_seeds_differ_from_each_other_and_from_the_seeds_own_children():
    seeds = range(5)
    streams = [bits(key_for(seed, purpose)) for seed, purpose in itertools.product(seeds, PURPOSES)]
    children = [bits(key) for seed in seeds for key in jax.random.split(jax.random.key(seed), 1000)]
    assert len({*streams, *children}) == len(streams) + len(children)


def test_seeds_of_all_purposes_numbers_and_runs_differ():
    found = [seed_for(*which) for which in itertools.product(range(20), PURPOSES, range(20))]
    assert len(set(found)) == len(found)
    assert all(0 <= seed < 2**31 for seed in found)
    assert not set(found) & set(range(10_000))  # a member of an ensemble of seed 0 is no other run


def test_a_purpose_that_nobody_has_registered_is_refused():
    with pytest.raises(ValueError, match="purpose: got 'dice', allowed: networks"):
        number_of("dice")  # pyright: ignore[reportArgumentType]


def test_every_registered_purpose_is_used():
    from pathlib import Path

    files = Path(__file__).parent.parent.joinpath("qjrl").rglob("*.py")
    sources = "".join(file.read_text() for file in files if file.name != "keys.py")
    assert [purpose for purpose in PURPOSES if f'"{purpose}"' not in sources] == []
