import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, random_bends

from qjrl.control.sensors import (
    MEMORY_SIZE,
    SETTLING,
    TIME_CONSTANTS,
    exact_reading,
    read_encoders,
    remember,
    sensed_configuration,
)
from qjrl.robot import bends_from_angles

NOISE_DEG = 0.25


def test_rotation_vectors_are_the_angle_along_the_direction():
    direction, angle = jnp.array([0.3, -2.0, 3.0]), jnp.array([0.001, 0.7, 3.0])
    expected = angle[:, None] * jnp.stack([jnp.cos(direction), jnp.sin(direction)], axis=1)
    np.testing.assert_allclose(
        exact_reading(arm_named("rolling_312"), bends_from_angles(direction, angle)), expected, atol=1e-12
    )


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-8, 1e-12, 0.0])
def test_rotation_vectors_go_and_come_back(scale):
    arm = arm_named("qj_2222")
    bends = scale * random_bends(arm, 1)[0]
    vectors = exact_reading(arm, jnp.asarray(bends))
    np.testing.assert_allclose(sensed_configuration(arm, vectors), bends, atol=1e-15, rtol=1e-12)


@pytest.mark.parametrize("convert", [exact_reading, sensed_configuration])
def test_values_and_gradients_are_finite_at_no_bend(convert):
    arm, zero = arm_named("qj_22"), jnp.zeros((2, 2))
    np.testing.assert_array_equal(convert(arm, zero), zero)
    slope = {exact_reading: 2.0, sensed_configuration: 0.5}[convert]
    jacobian = jax.jacobian(lambda value: convert(arm, value))(zero)
    np.testing.assert_allclose(jacobian, slope * np.eye(4).reshape(2, 2, 2, 2), atol=1e-9)


@pytest.mark.parametrize(("name", "dead"), [("qj_huang_4332", None), ("rolling_312", None), ("rolling_312", 2)])
def test_the_encoders_read_a_mean_over_the_segments_joints_and_no_bend_of_the_dead_one(name, dead):
    arm, count = arm_named(name), 20_000
    bends = jnp.asarray(random_bends(arm, 1)[0])
    keys = jax.random.split(jax.random.key(0), count)
    count_of_joints = np.array(arm.joints_per_segment)[:, None]
    working = count_of_joints - (np.arange(arm.num_segments) == dead)[:, None]
    read = jax.jit(jax.vmap(lambda key: read_encoders(arm, bends, NOISE_DEG, key, jnp.asarray(working[:, 0]))))
    errors = np.asarray(read(keys) - working / count_of_joints * exact_reading(arm, bends))
    expected = np.radians(NOISE_DEG) * np.sqrt(working) / count_of_joints * np.ones((1, 2))
    assert np.all(np.abs(errors.mean(axis=0)) < 4.0 * expected / np.sqrt(count))
    np.testing.assert_allclose(errors.std(axis=0), expected, rtol=4.0 / np.sqrt(2 * count))
    correlation = np.corrcoef(errors.reshape(count, -1).T) - np.eye(2 * arm.num_segments)
    assert np.abs(correlation).max() < 5.0 / np.sqrt(count)


def test_without_noise_the_encoders_read_the_truth():
    arm = arm_named("qj_22")
    bends = jnp.asarray(random_bends(arm, 1)[0])
    everyone = jnp.array(arm.joints_per_segment, float)
    np.testing.assert_array_equal(
        read_encoders(arm, bends, 0.0, jax.random.key(0), everyone), exact_reading(arm, bends)
    )


def test_the_memory_weighs_a_reading_by_its_age():
    """Each exponential mean is a sum over past readings, exp(-age/tau) of the newest's weight 1 - exp(-period/tau)."""
    period, count = 0.02, 40
    readings = np.random.default_rng(0).normal(size=(count, 2, 2))
    memory = jnp.zeros((MEMORY_SIZE, 2, 2))
    for reading in readings:
        memory = remember(memory, jnp.asarray(reading), jnp.zeros(()), period)
    ages = np.arange(count)[::-1] * period
    for constant, mean in zip(TIME_CONSTANTS, memory, strict=False):
        weights = (1.0 - np.exp(-period / constant)) * np.exp(-ages / constant)
        np.testing.assert_allclose(mean, np.einsum("t,tij->ij", weights, readings), atol=1e-6)


def test_when_the_arm_has_settled_all_means_begin_anew_and_nothing_read_before_is_left_in_them():
    period, arrival, count = 0.02, 10, 60
    settled = arrival + round(SETTLING / period)
    readings = np.random.default_rng(1).normal(size=(count, 2, 2))
    readings[:arrival] += 1e3
    memory = jnp.broadcast_to(readings[0], (MEMORY_SIZE, 2, 2))
    for step, reading in enumerate(readings[1:], start=1):
        memory = remember(memory, jnp.asarray(reading), jnp.asarray(max((step - arrival) * period, 0.0)), period)
    since = readings[settled:]
    assert len(since) > 10
    np.testing.assert_allclose(memory[-1], since.mean(axis=0), atol=1e-5)
    for constant, mean in zip(TIME_CONSTANTS, memory, strict=False):
        expected = since[0]
        for number, reading in enumerate(since[1:], start=2):
            expected = expected + max(1.0 / number, 1.0 - np.exp(-period / constant)) * (reading - expected)
        np.testing.assert_allclose(mean, expected, atol=1e-5)
    np.testing.assert_allclose(memory[2], memory[-1], atol=1e-5)  # the slowest is still a plain mean


def test_the_memory_of_what_never_changes_is_that():
    reading = jnp.array([[0.1, -0.2], [0.3, 0.0]])
    memory = jnp.broadcast_to(reading, (MEMORY_SIZE, 2, 2))
    np.testing.assert_array_equal(remember(memory, reading, jnp.asarray(1.0), 0.02), memory)
