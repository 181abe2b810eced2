import dataclasses

import jax
import numpy as np
import pytest

from qjrl.config import ConfigError, build
from qjrl.control.randomisation import RandomisationConfig, draw_parameters
from qjrl.simulation.stepping import PhysicalParameters

CONFIG = RandomisationConfig()
COUNT = 4000


@pytest.fixture(scope="module")
def drawn():
    keys = jax.random.split(jax.random.key(0), COUNT)
    return {
        name: np.asarray(value)
        for name, value in jax.jit(jax.vmap(lambda key: draw_parameters(CONFIG, key)))(keys).items()
    }


def test_all_physical_parameters_are_drawn_and_no_other(drawn):
    assert drawn.keys() == {field.name for field in dataclasses.fields(PhysicalParameters)}


@pytest.mark.parametrize("name", ["strand_damping_scale", "armature_scale", "gain_scale"])
def test_scales_are_uniform_in_the_logarithm_within_their_range(drawn, name):
    low, high = getattr(CONFIG, name)
    values = drawn[name]
    assert low <= values.min() and values.max() <= high * (1 + 1e-12)
    places = np.log(values / low) / np.log(high / low)
    np.testing.assert_allclose(np.histogram(places, 4, (0, 1))[0] / COUNT, 0.25, atol=0.03)


def test_friction_is_uniform_within_its_range(drawn):
    low, high = CONFIG.strand_friction
    places = (drawn["strand_friction"] - low) / (high - low)
    np.testing.assert_allclose(np.histogram(places, 4, (0, 1))[0] / COUNT, 0.25, atol=0.03)


def test_the_tilt_is_even_over_its_disc(drawn):
    tilt = np.degrees(np.linalg.norm(drawn["tilt"], axis=1))
    assert tilt.max() <= CONFIG.largest_tilt_deg * (1 + 1e-12)
    assert np.mean(tilt < CONFIG.largest_tilt_deg / 2) == pytest.approx(0.25, abs=0.03)  # a quarter of the area
    assert np.abs(drawn["tilt"].mean(axis=0)).max() < 0.005


def test_the_quantities_are_drawn_independently(drawn):
    columns = np.column_stack(list(drawn.values()))
    assert np.abs(np.corrcoef(columns.T) - np.eye(columns.shape[1])).max() < 0.08


def test_a_range_of_no_width_is_that_value():
    config = RandomisationConfig((2.0, 2.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0), 0.0, 0.0)
    found = draw_parameters(config, jax.random.key(1))
    assert {name: np.asarray(value).tolist() for name, value in found.items()} == {
        "strand_damping_scale": 2.0,
        "strand_friction": 1.0,
        "armature_scale": 1.0,
        "gain_scale": 1.0,
        "tilt": [0.0, 0.0],
    }


def test_no_key_is_used_twice():
    with jax.debug_key_reuse(True):
        jax.jit(lambda key: draw_parameters(CONFIG, key))(jax.random.key(0))["tilt"].block_until_ready()
        jax.vmap(lambda key: draw_parameters(CONFIG, key))(jax.random.split(jax.random.key(0), 3))


@pytest.mark.parametrize("interval", [[1.25, 0.8], [0.0, 1.0]])
def test_a_range_that_is_none_is_one_line(interval):
    with pytest.raises(
        ConfigError, match=r"^randomisation.gain_scale: got .*allowed: \[low, high\] with 0 < low <= high"
    ):
        build(RandomisationConfig, {"gain_scale": interval}, "randomisation")
