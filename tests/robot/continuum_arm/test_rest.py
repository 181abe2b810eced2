"""Where a continuum arm rests."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from golden_plant import (
    BENDS,
    LENGTH,
    RADIUS,
    TENSIONS,
    TIPS,
    TURNS,
    as_the_prototype_weighed,
    commands_of,
    frictionless_plant,
)
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from qjrl.robot.continuum_arm.defects import DefectSizes, with_defects
from qjrl.robot.continuum_arm.energy import chain_of, energy_and_residual, shapes_of
from qjrl.robot.continuum_arm.plant import cables_of, nominal_bends, nominal_plant
from qjrl.robot.continuum_arm.rest import LARGEST_RESIDUAL, compiled_rest, rest
from qjrl.robot.continuum_arm.rod import Discretisation, elastic_slopes
from qjrl.xla_options import jit_of_chains

COUNTS = Discretisation()
FEW = Discretisation(bending=2, torsion=1, stretch=1, steps=1)
FINE = Discretisation(bending=6, torsion=2, stretch=1, steps=8)
COMMANDS = commands_of(BENDS)
MIRROR = np.diag([1.0, -1.0, 1.0])

energy_of = jit_of_chains(
    lambda plant, commands, previous, modes, counts: energy_and_residual(
        plant, cables_of(plant, commands, previous), modes, counts
    ),
    static_argnums=4,
)


def rested(plant, commands, previous=None):
    """All tests ask for four rows of four segments of four cables, so that one compiled program serves them all."""
    return compiled_rest(plant, commands, commands if previous is None else previous, COUNTS)


def frames(pose):
    """Positions (n, 3) and rotations (n, 3, 3)."""
    x, y = np.asarray(pose[:, 3:6]), np.asarray(pose[:, 6:])
    return np.asarray(pose[:, :3]), np.stack([x, y, np.cross(x, y)], axis=2)


@pytest.fixture(scope="module")
def worn_plant():
    plant = nominal_plant(length=[0.12, 0.11, 0.13, 0.12], anchor_radius=RADIUS, gravity=(9.0, 1.0, -2.0))
    return with_defects(plant, DefectSizes(), seed=3)


@pytest.fixture(scope="module")
def previous():
    return COMMANDS + np.random.default_rng(2).normal(scale=4e-4, size=COMMANDS.shape)


def test_an_arm_without_defects_rests_where_an_independent_prototype_has_found():
    at_rest = rested(as_the_prototype_weighed(frictionless_plant(), COUNTS.steps), COMMANDS)
    positions, rotations = frames(at_rest.pose)
    np.testing.assert_allclose(positions * 1e3, TIPS, atol=0.003)
    np.testing.assert_allclose(Rotation.from_matrix(rotations).as_rotvec(degrees=True), TURNS, atol=0.003)
    np.testing.assert_allclose(at_rest.tension[:, 0], TENSIONS, atol=0.01)
    assert at_rest.converged.all() and at_rest.residual.max() <= 1e-9


def lowest(plant, commands, start, counts):
    """Modes (size, S, 1) of least energy of one row by a quasi-Newton method of SciPy."""
    scale = np.sqrt(
        np.stack([np.broadcast_to(slope, (plant.num_segments, 1)) for slope in elastic_slopes(plant.stiffness, counts)])
    )

    def values(flat):
        energy, slope = energy_of(plant, commands, commands, flat.reshape(scale.shape) / scale, counts)
        return float(energy[0]), np.asarray(slope / scale).ravel()

    found = minimize(values, (start * scale).ravel(), jac=True, method="BFGS", options=dict(gtol=1e-7, maxiter=2000))
    return found.x.reshape(scale.shape) / scale


@functools.partial(jit_of_chains, static_argnums=2)
def tip_of(plant, modes, counts):
    return jnp.stack(jax.tree.leaves(chain_of(plant, shapes_of(plant, modes, counts)).tip))[:, 0]


def test_more_modes_and_steps_move_the_tip_by_a_fifth_of_a_millimetre_and_agree_with_the_prototypes_finer_rows():
    plant, row = as_the_prototype_weighed(frictionless_plant(), FINE.steps), slice(1, 2)
    coarse = rested(frictionless_plant(), COMMANDS)
    start = np.zeros((FINE.size, 4, 1))
    start[0] = BENDS[1, :, :1]
    modes = lowest(plant, COMMANDS[row], start, FINE)
    fine = tip_of(plant, modes, FINE)
    np.testing.assert_allclose(fine * 1e3, [346.318, 0.0, 215.321], atol=0.002)
    assert np.linalg.norm(fine - coarse.pose[1, :3]) < 2e-4


def test_the_residual_is_the_slope_of_the_energy(worn_plant, previous):
    generator = np.random.default_rng(0)
    modes = generator.normal(scale=0.2, size=(COUNTS.size, 4, 4))
    modes[-1] *= 1e-3  # stretch
    _, slope = energy_of(worn_plant, COMMANDS, previous, modes, COUNTS)
    for _ in range(6):
        way = generator.normal(size=modes.shape)
        way[-1] *= 1e-3
        energies = [energy_of(worn_plant, COMMANDS, previous, modes + step * way, COUNTS)[0] for step in (-1e-6, 1e-6)]
        np.testing.assert_allclose(
            (energies[1] - energies[0]) / 2e-6, np.sum(slope * way, axis=(0, 1)), rtol=1e-6, atol=1e-6
        )


def test_an_arm_at_rest_is_a_minimum_with_forces_in_balance(worn_plant, previous):
    at_rest = rested(worn_plant, COMMANDS, previous)
    modes = np.asarray(at_rest.modes).transpose(2, 1, 0)
    least, slope = energy_of(worn_plant, COMMANDS, previous, modes, COUNTS)
    assert np.abs(slope).max() <= LARGEST_RESIDUAL and at_rest.converged.all()
    generator = np.random.default_rng(1)
    for _ in range(10):
        moved = modes + generator.normal(scale=0.02, size=modes.shape)
        assert (energy_of(worn_plant, COMMANDS, previous, moved, COUNTS)[0] > least).all()


def test_stiff_cables_on_soft_rods_without_gravity_tend_to_the_nominal_pose():
    nominal, errors = [], []
    for segments in BENDS:
        position, rotation = np.zeros(3), np.eye(3)
        for bend in segments:
            angle = max(np.linalg.norm(bend), 1e-12)
            arc = LENGTH * np.array([*(bend * (1 - np.cos(angle)) / angle**2), np.sin(angle) / angle])
            position = position + rotation @ arc
            rotation = rotation @ Rotation.from_rotvec([-bend[1], bend[0], 0.0]).as_matrix()
        nominal.append(position)
    longer = 0.02 * LENGTH  # rods 2 % too long press on the cables, which all stay taut
    for factor in (1.0, 10.0, 100.0):
        plant = nominal_plant(
            length=[LENGTH + longer] * 4,
            anchor_radius=RADIUS,
            gravity=np.zeros(3),
            friction=0.0,
            pretension=0.0,
            bending_stiffness=0.06,
            axial_stiffness=1e3,
            cable_stiffness=3e4 * factor,
        )
        at_home = np.full(plant.home_offset.shape, -longer)
        plant = dataclasses.replace(plant, home_offset=at_home, slack_length=plant.slack_length / factor)
        at_rest = rested(plant, COMMANDS)
        assert at_rest.converged.all() and at_rest.tension.min() > 0.1
        errors.append(np.linalg.norm(at_rest.pose[:, :3] - np.array(nominal), axis=1).max())
    assert errors[1] < errors[0] / 8 and errors[2] < errors[1] / 8 and errors[2] < 3e-5, errors


def moved_anchors(plant, matrix, places):
    """The plant turned or mirrored by `matrix` (3, 3): cable j of the old one is cable places[j] of the new one."""
    back = np.argsort(places)
    planar, handedness = matrix[:2, :2], np.linalg.det(matrix)
    named = lambda values: values[:, back]  # noqa: E731
    return dataclasses.replace(
        plant,
        lower_anchors=named(plant.lower_anchors @ planar.T),
        upper_anchors=named(plant.upper_anchors @ planar.T),
        home_offset=named(plant.home_offset),
        cable_gain=named(plant.cable_gain),
        preset_bend=plant.preset_bend @ planar.T,
        gravity=matrix @ plant.gravity,
        tip_rotation=handedness * matrix @ plant.tip_rotation,
    )


@pytest.mark.parametrize(
    ("matrix", "places"),
    [(np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), [1, 2, 3, 0]), (MIRROR, [0, 3, 2, 1])],
    ids=["turned by a quarter", "mirrored"],
)
def test_an_arm_turned_or_mirrored_with_its_cables_renamed_gives_the_answer_turned_or_mirrored(
    worn_plant, previous, matrix, places
):
    old = rested(worn_plant, COMMANDS, previous)
    back = np.argsort(places)
    new = rested(moved_anchors(worn_plant, matrix, places), COMMANDS[:, :, back], previous[:, :, back])
    (position, rotation), (new_position, new_rotation) = frames(old.pose), frames(new.pose)
    np.testing.assert_allclose(new_position, position @ matrix.T, atol=1e-9)
    np.testing.assert_allclose(new_rotation, matrix @ rotation @ matrix.T, atol=1e-8)
    np.testing.assert_allclose(new.tension, old.tension[:, :, back], atol=1e-5)


def test_friction_remembers_the_way_that_a_cable_last_moved():
    plant = nominal_plant(length=[LENGTH] * 4, anchor_radius=RADIUS)
    before = COMMANDS + np.array([0.01, -0.01, 0.0, 0.01])  # reeled in, paid out, left alone, reeled in
    factor = np.asarray(
        cables_of(plant, jnp.asarray(COMMANDS), jnp.asarray(before)).stiffness / plant.cable_stiffness
    ).transpose(2, 1, 0)
    bends = np.linalg.norm(BENDS, axis=2)
    wrap = 0.5 + np.cumsum(bends, axis=1) - bends
    np.testing.assert_allclose(np.log(factor), 0.15 * wrap[:, :, None] * np.array([-1.0, 1.0, 0.0, -1.0]), atol=1e-12)
    one, other = rested(plant, COMMANDS, before), rested(plant, COMMANDS, 2.0 * COMMANDS - before)
    assert np.linalg.norm(one.pose[:, :3] - other.pose[:, :3], axis=1).min() > 1e-3
    smooth = frictionless_plant()
    np.testing.assert_allclose(rested(smooth, COMMANDS, before).pose, rested(smooth, COMMANDS).pose, atol=1e-9)


def test_a_row_without_numbers_says_so_and_leaves_the_others_alone():
    plant, spoilt = frictionless_plant(), COMMANDS.copy()
    spoilt[1] = np.nan
    at_rest, alone = rested(plant, spoilt), rested(plant, COMMANDS)
    assert at_rest.converged.tolist() == [True, False, True, True]
    np.testing.assert_allclose(np.delete(at_rest.pose, 1, 0), np.delete(alone.pose, 1, 0), atol=1e-9)


def plant_of_two_segments_of_three_cables(turn=np.eye(3)):
    """Turned about its axis, and two rows of commands that turn with it."""
    bends = np.array([[[0.4, 0.1], [-0.2, 0.3]], [[0.1, -0.5], [0.3, 0.1]]])
    plant = frictionless_plant(num_segments=2, num_cables=3)
    return dataclasses.replace(plant, gravity=turn @ plant.gravity), commands_of(bends @ turn[:2, :2].T, 3)


def test_two_segments_of_three_cables_turned_by_a_third_give_the_answer_turned():
    turn = Rotation.from_euler("z", -120.0, degrees=True).as_matrix()
    old, new = (
        compiled_rest(plant, commands, commands, FEW)
        for plant, commands in (plant_of_two_segments_of_three_cables(), plant_of_two_segments_of_three_cables(turn))
    )
    assert old.converged.all() and old.tension.shape == (2, 2, 3)
    np.testing.assert_allclose(frames(new.pose)[0], frames(old.pose)[0] @ turn.T, atol=1e-9)


def test_slopes_by_every_number_of_the_plant_and_by_the_commands_are_differences():
    plant, commands = plant_of_two_segments_of_three_cables()
    plant = with_defects(dataclasses.replace(plant, friction=np.float64(0.15)), DefectSizes(), seed=3)
    previous = commands + np.random.default_rng(2).normal(scale=4e-4, size=commands.shape)

    def seen(plant, commands, previous):
        at_rest = rest(plant, commands, previous, FEW)
        return jnp.sum(at_rest.pose * weights) + 1e-3 * jnp.sum(at_rest.tension)

    generator = np.random.default_rng(4)
    weights = generator.normal(size=(2, 9))
    everything = (plant, commands, previous)
    slopes = jit_of_chains(jax.grad(seen, argnums=(0, 1, 2)))(*everything)
    leaves, tree = jax.tree.flatten(everything)
    names = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(everything)]

    def value(number, leaf):
        at_rest = compiled_rest(*jax.tree.unflatten(tree, [*leaves[:number], leaf, *leaves[number + 1 :]]), FEW)
        return float(np.sum(at_rest.pose * weights) + 1e-3 * np.sum(at_rest.tension))

    for number, (name, leaf, slope) in enumerate(zip(names, leaves, jax.tree.leaves(slopes), strict=True)):
        way = generator.normal(size=np.shape(leaf))
        step = 1e-5 * (np.abs(leaf).max() or 1.0)
        if number in (len(leaves) - 1, len(leaves) - 2):
            step = 1e-7
        difference = (value(number, leaf + step * way) - value(number, leaf - step * way)) / (2.0 * step)
        assert np.sum(slope * way) == pytest.approx(difference, rel=2e-5, abs=2e-5), name


def test_bends_meant_by_commands_are_those_that_the_commands_were_made_of():
    for num_cables in (3, 4, 6):
        plant = frictionless_plant(num_cables=num_cables)
        for bends in (BENDS, 1e-5 * BENDS, 2.9 * BENDS):
            found = nominal_bends(plant, jnp.asarray(commands_of(bends, num_cables)))
            np.testing.assert_allclose(found, bends, atol=1e-12)
