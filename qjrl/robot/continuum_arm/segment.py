"""One segment as a circular arc: pose and cables from its bend b = theta (cos alpha, sin alpha) (paper 002, Eqs. 2 to 12).

The paper's angles (alpha, theta) mean nothing at theta = 0; the bend is smooth through the straight segment. Three of the
printed formulas are wrong and are mended here: Eq. 4 lacks the second argument of the arctangent and has the other sign,
Eq. 11 prints cot(1/theta) for cot(theta/2), and the anchors of Eq. 2 run clockwise (`data/table1`, tests).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from qjrl.geometry.se3 import exp_rotation, sine_ratio

# As near to half a turn as a chord is taken: beyond it there is no bend of such a chord.
_LARGEST_CHORD = 1.0 - 1e-12


def segment_pose(length: Float[Array, ""], bend: Float[Array, "2"]) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Position [m] and rotation of a segment's end in the frame of its base.

    Args:
        length: of the arc [m].
        bend: [rad].
    """
    squared = jnp.sum(bend**2)
    chord, sine = chord_ratio(squared), sine_ratio(squared)
    versine = 0.5 * chord**2  # (1 - cos theta) / theta^2
    position = length * jnp.stack([versine * bend[0], versine * bend[1], sine])
    return position, exp_rotation(jnp.stack([-bend[1], bend[0], jnp.zeros_like(squared)]))


def segment_cables(
    length: Float[Array, ""], radius: Float[Array, ""], directions: Float[Array, "cables 2"], bend: Float[Array, "2"]
) -> Float[Array, "cables"]:
    """Distances between the anchors of a segment's two discs [m] (Eq. 2).

    Args:
        directions: unit vectors to the anchors.
    """
    return chord_ratio(jnp.sum(bend**2)) * (length - radius * directions @ bend)


def segment_bend(
    radius: Float[Array, ""], directions: Float[Array, "cables 2"], lengths: Float[Array, "cables"]
) -> Float[Array, "2"]:
    """The bend of a segment's cables [m], exact; any common part drops out (Eqs. 4 and 5 mended, for any anchors)."""
    centred = directions - jnp.mean(directions, axis=0)
    (xx, xy), (_, yy) = centred.T @ centred
    x, y = -(centred.T @ lengths) / radius
    determinant = xx * yy - xy**2
    chords = jnp.stack([yy * x - xy * y, xx * y - xy * x]) / determinant  # 2 sin(theta/2), along the bend
    return chords * arcsine_ratio(jnp.sum(chords**2) / 4.0)


def chord_ratio(squared: Float[Array, ""]) -> Float[Array, ""]:
    """2 sin(theta/2) / theta of theta^2."""
    return sine_ratio(squared / 4.0)


def arcsine_ratio(squared: Float[Array, ""]) -> Float[Array, ""]:
    """arcsin(s) / s of s^2, up to half a turn's s = 1."""
    is_small = squared < 1e-4
    sine = jnp.sqrt(jnp.where(is_small, 0.25, jnp.minimum(squared, _LARGEST_CHORD)))
    series = 1.0 + squared / 6.0 + 3.0 / 40.0 * squared**2 + 15.0 / 336.0 * squared**3 + 105.0 / 3456.0 * squared**4
    return jnp.where(is_small, series, jnp.arcsin(sine) / sine)
