"""The rod against shapes that are known from elsewhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root
from scipy.spatial.transform import Rotation

from qjrl.robot.continuum_arm.rod import Discretisation, RodStiffness, elastic_energy, elastic_slopes, rod_shape
from qjrl.xla_options import jit_of_chains

SOFT = RodStiffness(bending=1.0, torsion=0.7, stretch=3.0)
FINE = Discretisation(bending=7, torsion=0, stretch=0, steps=16)

shape_of = jit_of_chains(rod_shape, static_argnums=2)
energy_slope = jax.jit(
    jax.grad(lambda modes, stiffness, counts: jnp.sum(elastic_energy(modes, jnp.zeros((2, 1)), stiffness, counts))),
    static_argnums=2,
)


def end_of(shape):
    return np.stack(jax.tree.leaves(shape.end))


def rotation_of(shape):
    return np.stack(
        [np.stack(jax.tree.leaves(column)) for column in jax.tree.leaves(shape.rotation, is_leaf=is_vector)], 1
    )


def is_vector(value):
    return hasattr(value, "dot") and not hasattr(value, "shape") and not hasattr(value, "product")


@pytest.fixture(scope="module")
def bent_by_tip_force():
    """Modes of a rod of length 1 and EI = 1 at rest under a force across its end."""

    def energy(bends, force):
        modes = jnp.concatenate([bends, jnp.zeros(FINE.bending)])  # the other direction has no force
        return elastic_energy(modes, jnp.zeros(2), SOFT, FINE) - force * rod_shape(modes, 1.0, FINE).end.x

    slope = jit_of_chains(jax.grad(energy))

    def solve(force):
        found = root(lambda bends: np.asarray(slope(bends, force)), np.eye(FINE.bending)[0], tol=1e-12)
        assert np.abs(slope(found.x, force)).max() < 1e-9
        return np.concatenate([found.x, np.zeros(FINE.bending)])

    return solve


def elastica_tip(force):
    """Tip of a cantilever of length 1, EI = 1, by shooting for the curvature at its base."""

    def integrated(curvature):
        def slopes(_, state):
            angle, bend = state[:2]
            return [bend, -force * np.cos(angle), np.sin(angle), np.cos(angle)]

        return solve_ivp(slopes, (0.0, 1.0), [0.0, curvature, 0.0, 0.0], rtol=1e-11, atol=1e-12).y[:, -1]

    curvature = brentq(lambda curvature: integrated(curvature)[1], 0.0, force, xtol=1e-13)
    return integrated(curvature)[2:]


@pytest.mark.parametrize("force", [0.5, 1.0, 2.0, 5.0])
def test_a_cantilever_with_a_force_at_its_tip_is_the_elastica(bent_by_tip_force, force):
    x, y, z = end_of(shape_of(bent_by_tip_force(force), 1.0, FINE))
    np.testing.assert_allclose([x, z], elastica_tip(force), atol=3e-6)
    assert abs(y) < 1e-12


def test_a_moment_alone_makes_a_circular_arc():
    counts, length, stiffness = Discretisation(), 0.3, RodStiffness(bending=2.0, torsion=0.7, stretch=3.0)
    moment = np.array(
        [[1.5, 0.01, 0.0, -2.0], [-0.7, 0.0, 0.0, 1.0]]
    )  # work of a moment about (-y, x): moment times bend
    modes = np.zeros((counts.size, 4))
    modes[[0, counts.bending]] = moment / stiffness.bending
    slope = energy_slope(modes, stiffness, counts)
    np.testing.assert_allclose(slope[jnp.array([0, counts.bending])], moment, atol=1e-12)
    shape = shape_of(modes, length, counts)
    bend = moment / stiffness.bending
    angle = np.maximum(np.linalg.norm(bend, axis=0), 1e-12)
    arc = length * np.stack([*(bend * (1 - np.cos(angle)) / angle**2), np.sin(angle) / angle])
    np.testing.assert_allclose(end_of(shape), arc, atol=1e-10)
    turns = Rotation.from_rotvec(np.stack([-bend[1], bend[0], 0 * angle], 1)).as_matrix()
    np.testing.assert_allclose(rotation_of(shape).transpose(2, 0, 1), turns, atol=1e-10)


def test_a_torque_alone_twists_a_straight_rod():
    counts = Discretisation()
    modes = np.zeros((counts.size, 1))
    modes[2 * counts.bending] = torque = 1.2 * SOFT.torsion
    slope = energy_slope(modes, SOFT, counts)
    assert slope[2 * counts.bending, 0] == pytest.approx(SOFT.torsion * torque, rel=1e-12)
    shape = shape_of(modes, 0.3, counts)
    np.testing.assert_allclose(end_of(shape)[:, 0], [0.0, 0.0, 0.3], atol=1e-14)
    turn = Rotation.from_rotvec([0.0, 0.0, torque]).as_matrix()
    np.testing.assert_allclose(rotation_of(shape)[..., 0], turn, atol=1e-12)


def random_modes(counts, rows=3):
    return np.random.default_rng(5).normal(size=(counts.size, rows)) * 0.4


def plain_shape(modes, length, counts):
    """The same differential equations by SciPy, one row: end, rotation, mean position."""

    def slopes(place, state):
        values = np.polynomial.legendre.legvander(2 * place - 1, counts.bending + counts.torsion + counts.stretch)[0]
        bend_x, bend_y, twist, stretch = (values[: len(part)] @ part for part in counts.parts(modes))
        rotation = state[3:12].reshape(3, 3)
        spin = np.array([[0, -twist, bend_x], [twist, 0, bend_y], [-bend_x, -bend_y, 0]])
        return np.concatenate([length * (1 + stretch) * rotation[:, 2], (rotation @ spin).ravel(), state[:3]])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel(), np.zeros(3)])
    state = solve_ivp(slopes, (0.0, 1.0), start, rtol=1e-11, atol=1e-13).y[:, -1]
    return state[:3], state[3:12].reshape(3, 3), state[12:]


def test_shapes_converge_with_the_fourth_power_of_the_steps_to_the_rods_differential_equation():
    errors = []
    for steps in (3, 6, 12):
        counts = Discretisation(bending=3, torsion=2, stretch=2, steps=steps)
        modes = random_modes(counts)
        shape = shape_of(modes, 0.5, counts)
        known = [plain_shape(row, 0.5, counts) for row in modes.T]
        mean = np.stack(jax.tree.leaves(shape.first_moment))
        found = (end_of(shape), rotation_of(shape), mean)
        errors.append(
            [
                np.abs(one - np.stack(other, -1)).max()
                for one, other in zip(found, zip(*known, strict=True), strict=True)
            ]
        )
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert (ratios[:, :2] > 11.0).all(), errors  # 16 in the limit
    assert (ratios[:, 2] > 3.7).all(), errors  # the mean position, for the hose's weight alone: 4 in the limit
    assert np.max(errors[-1][:2]) < 1e-6


def test_slopes_of_the_energy_are_its_second_derivatives():
    counts = Discretisation(bending=3, torsion=2, stretch=2, steps=2)
    energy = lambda modes: elastic_energy(modes, jnp.array([0.1, -0.2]), SOFT, counts)  # noqa: E731
    hessian = jax.jit(jax.hessian(energy))(random_modes(counts)[:, 0])
    np.testing.assert_allclose(hessian, np.diag(elastic_slopes(SOFT, counts)), atol=1e-14)
