import jax
import jax.numpy as jnp
import numpy as np
from arms import arm_named, random_bends

from qjrl.studies.residual.noise_floor import encoder_floor

ARM = arm_named("qj_2222")
BENDS = jnp.asarray(random_bends(ARM, 200))


def floor(noise_deg, frames):
    return np.asarray(encoder_floor(ARM, BENDS, noise_deg, jnp.full(len(BENDS), frames), jax.random.key(0)))


def test_without_noise_there_is_no_floor():
    assert floor(0.0, 1).max() < 1e-9


def test_the_floor_falls_as_one_over_the_noise_and_over_the_root_of_the_number_of_readings():
    one = floor(0.01, 1)
    np.testing.assert_allclose(floor(0.01, 25), one / 5, rtol=0.02, atol=1e-7)
    np.testing.assert_allclose(floor(0.002, 1), one / 5, rtol=0.02, atol=1e-7)


def test_it_is_of_the_size_that_a_lever_gives():
    """A joint's noise over the joints of a segment turns what lies beyond by joints times noise / sqrt(joints)."""
    joints, beyond = np.array(ARM.joints_per_segment), np.array([0.9, 0.65, 0.4, 0.15])
    length = sum(joints) * ARM.config.link_length
    lever = np.radians(0.25) * np.sqrt(np.sum(2 * joints * (beyond * length) ** 2))
    assert 0.3 * lever < np.median(floor(0.25, 1)) < 2.0 * lever
