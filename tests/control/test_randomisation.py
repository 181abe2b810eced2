import dataclasses

import jax
import numpy as np
import pytest
from arms import arm_named

from qjrl.config import ConfigError, build
from qjrl.control.randomisation import RandomisationConfig, draw_parameters
from qjrl.robot.plant import PhysicalParameters

ARM = arm_named("qj_22")
CONFIG = RandomisationConfig(strand_stiffness_scale=(0.8, 1.1), payload=(0.0, 0.1))
COUNT = 4000


@pytest.fixture(scope="module")
def drawn():
    keys = jax.random.split(jax.random.key(0), COUNT)
    found = jax.jit(jax.vmap(lambda key: draw_parameters(CONFIG, ARM, key)))(keys)
    return jax.tree.map(np.asarray, found).arrays()


def test_all_physical_parameters_are_drawn_of_the_shapes_that_a_stepper_takes(drawn):
    nominal = PhysicalParameters.nominal(ARM, COUNT).arrays()
    assert {name: values.shape for name, values in drawn.items()} == {n: values.shape for n, values in nominal.items()}


@pytest.mark.parametrize("name", ["strand_damping_scale", "armature_scale", "gain_scale", "strand_stiffness_scale"])
def test_scales_are_uniform_in_the_logarithm_within_their_range(drawn, name):
    low, high = getattr(CONFIG, name)
    values = drawn[name]
    assert low <= values.min() and values.max() <= high * (1 + 1e-12)
    places = np.log(values / low) / np.log(high / low)
    np.testing.assert_allclose(np.histogram(places, 4, (0, 1))[0] / places.size, 0.25, atol=0.03)


@pytest.mark.parametrize("name", ["strand_friction", "payload"])
def test_friction_and_payload_are_uniform_within_their_range(drawn, name):
    low, high = getattr(CONFIG, name)
    places = (drawn[name] - low) / (high - low)
    np.testing.assert_allclose(np.histogram(places, 4, (0, 1))[0] / COUNT, 0.25, atol=0.03)


def test_the_tilt_is_even_over_its_disc(drawn):
    tilt = np.degrees(np.linalg.norm(drawn["tilt"], axis=1))
    assert tilt.max() <= CONFIG.largest_tilt_deg * (1 + 1e-12)
    assert np.mean(tilt < CONFIG.largest_tilt_deg / 2) == pytest.approx(0.25, abs=0.03)  # a quarter of the area
    assert np.abs(drawn["tilt"].mean(axis=0)).max() < 0.005


def test_a_tilt_of_no_range_is_just_that_in_every_direction():
    config = RandomisationConfig(largest_tilt_deg=10.0, least_tilt_deg=10.0)
    keys = jax.random.split(jax.random.key(1), 200)
    tilt = np.degrees(jax.vmap(lambda key: draw_parameters(config, ARM, key).tilt)(keys))
    np.testing.assert_allclose(np.linalg.norm(tilt, axis=1), 10.0, rtol=1e-12)
    assert np.all(np.histogram(np.arctan2(*tilt.T), 4, (-np.pi, np.pi))[0] > 30)


def test_the_quantities_are_drawn_independently(drawn):
    columns = np.column_stack(list(drawn.values()))  # every strand is one
    assert np.abs(np.corrcoef(columns.T) - np.eye(columns.shape[1])).max() < 0.08


def test_a_range_of_no_width_is_that_value():
    config = RandomisationConfig((2.0, 2.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0), 0.0, 0.0)
    found = draw_parameters(config, ARM, jax.random.key(1))
    assert {field.name: np.asarray(getattr(found, field.name)).tolist() for field in dataclasses.fields(found)} == {
        "strand_damping_scale": 2.0,
        "strand_friction": 1.0,
        "armature_scale": 1.0,
        "gain_scale": 1.0,
        "tilt": [0.0, 0.0],
        "strand_stiffness_scale": [1.0] * ARM.num_strands,
        "payload": 0.0,
    }


def test_no_key_is_used_twice():
    with jax.debug_key_reuse(True):
        jax.jit(lambda key: draw_parameters(CONFIG, ARM, key))(jax.random.key(0)).tilt.block_until_ready()
        jax.vmap(lambda key: draw_parameters(CONFIG, ARM, key))(jax.random.split(jax.random.key(0), 3))


@pytest.mark.parametrize("interval", [[1.25, 0.8], [0.0, 1.0]])
def test_a_range_that_is_none_is_one_line(interval):
    with pytest.raises(
        ConfigError, match=r"^randomisation.gain_scale: got .*allowed: \[low, high\] with 0 < low <= high"
    ):
        build(RandomisationConfig, {"gain_scale": interval}, "randomisation")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"backlash": [0.002, 0.001]}, r"^randomisation.backlash: got .*allowed: \[low, high\] with 0 <= low <= high"),
        ({"delay": [0, 1.5]}, r"^randomisation.delay\[1\]: got 1.5, allowed: an integer from 0 to 100"),
        ({"least_tilt_deg": 6.0}, r"^randomisation.least_tilt_deg: got 6.0, allowed: at most largest_tilt_deg 5.0"),
        ({"dead_encoder_share": 2.0}, r"^randomisation.dead_encoder_share: got 2.0"),
    ],
)
def test_impossible_faults_are_one_line(change, message):
    with pytest.raises(ConfigError, match=message):
        build(RandomisationConfig, change, "randomisation")
