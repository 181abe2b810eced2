"""Defects of one arm and not of another."""

import dataclasses

import jax
import numpy as np
import pytest
from golden_plant import frictionless_plant

from qjrl.config import ConfigError
from qjrl.robot.continuum_arm.defects import DefectSizes, with_defects

DRAWN = ("lower_anchors", "upper_anchors", "home_offset", "cable_gain", "tip_rotation", "preset_bend")
NONE = {field.name: 0.0 for field in dataclasses.fields(DefectSizes)}


def changes(sizes, seed, plant):
    worn = with_defects(plant, sizes, seed)
    return {field.name: getattr(worn, field.name) - getattr(plant, field.name) for field in dataclasses.fields(plant)}


def test_the_same_seed_gives_the_same_bits_and_another_gives_others():
    plant = frictionless_plant()
    one, same, other = (with_defects(plant, DefectSizes(), seed) for seed in (7, 7, 8))
    for first, second in zip(jax.tree.leaves(one), jax.tree.leaves(same), strict=True):
        np.testing.assert_array_equal(first, second)
    for name in DRAWN:
        assert (getattr(one, name) != getattr(other, name)).all(), name


def test_defects_have_their_sizes_and_touch_nothing_else():
    found = changes(DefectSizes(), 1, frictionless_plant(num_segments=2000))
    sigmas = dict(lower_anchors=5e-4, upper_anchors=5e-4, home_offset=5e-4, cable_gain=0.01, preset_bend=0.05)
    for name, sigma in sigmas.items():
        assert np.std(found[name]) == pytest.approx(sigma, rel=0.05), name
        assert abs(np.mean(found[name])) < 0.1 * sigma, name
    tips = [changes(DefectSizes(), seed, frictionless_plant())["tip_rotation"] for seed in range(30)]
    assert np.degrees(np.std(tips)) == pytest.approx(0.3, rel=0.25)
    assert not any(np.any(change) for name, change in found.items() if name not in DRAWN)


@pytest.mark.parametrize("name", list(NONE))
def test_one_kind_of_defect_is_drawn_whether_or_not_there_are_others(name):
    plant = frictionless_plant()
    alone = changes(DefectSizes(**{**NONE, name: getattr(DefectSizes(), name)}), 5, plant)
    together = changes(DefectSizes(), 5, plant)
    drawn = [key for key, change in alone.items() if np.any(change)]
    assert drawn and set(drawn) <= set(DRAWN)
    for key in drawn:
        np.testing.assert_allclose(alone[key], together[key], rtol=1e-12, atol=1e-18)


def test_a_size_below_zero_is_refused():
    with pytest.raises(ConfigError, match=r"anchor: got -0\.001"):
        DefectSizes(anchor=-0.001)
