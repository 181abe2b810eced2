import dataclasses

import numpy as np
import pytest
from worlds import (
    ARM,
    CONFIG,
    ENGINE,
    NUM_ENVS,
    World,
    assert_same_bits,
    bank,
    nothing,
    policy_that,
    random_actions,
    rows_of,
)

from qjrl.control.bases import BASES, controller_name
from qjrl.control.comparison import compare_controllers
from qjrl.control.evaluation import Evaluator, arrives_in_time, do_nothing
from qjrl.control.motors import ramp_time
from qjrl.control.policy_training import PolicyConfig
from qjrl.control.targets import TARGET_SETS
from qjrl.learning.ppo.environment import ACTOR_KEY
from qjrl.simulation.engines import make_stepper
from qjrl.simulation.settle_problem import SettleConfig
from qjrl.simulation.stepping import MujocoStepper

QUANTITIES = ("position_error", "orientation_error", "strand_tension", "is_valid")


def evaluator_of(targets, seed=5):
    return Evaluator(ARM, CONFIG, targets, MujocoStepper(ARM, len(targets.target)), seed)


@pytest.fixture(scope="module")
def evaluator():
    return evaluator_of(rows_of(bank(), range(NUM_ENVS)))


@pytest.fixture(scope="module")
def base_alone(evaluator):
    return evaluator.evaluate()


def assert_same_evaluation(one, other):
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(getattr(one, quantity), getattr(other, quantity), err_msg=quantity)


def physics_of(world):
    """Parameters of every arm, as the physics has them, and the first readings of its encoders."""
    observation = world.reset()
    parameters = world.stepper._parameters.arrays()
    return parameters, observation[ACTOR_KEY][:, 2 * ARM.num_segments : 4 * ARM.num_segments]


def test_evaluating_twice_gives_the_same_numbers(evaluator, base_alone):
    assert_same_evaluation(evaluator.evaluate(), base_alone)


def test_doing_nothing_is_the_base_controller(evaluator, base_alone):
    assert_same_evaluation(evaluator.evaluate(lambda seen: do_nothing(seen, ARM.num_cables)), base_alone)


def test_every_controller_meets_the_same_arms_and_the_same_noise(evaluator):
    """The parameters and the readings' noise do not depend on what the controller does."""
    world = World(seed=5)
    parameters, readings = physics_of(world)
    noise = []
    for actions in (np.zeros((6, NUM_ENVS, ARM.num_cables)), random_actions(6)):
        world.reset()
        for action in actions:
            world.step(action)
        assert_same_bits(world.stepper._parameters.arrays(), parameters)
        noise.append(world.state.key)
    assert_same_bits(*noise)
    targets = rows_of(bank(), range(NUM_ENVS))
    other_base = dataclasses.replace(targets, base_lengths=0.5 * targets.base_lengths)
    other_parameters, other_readings = physics_of(World(targets=other_base, seed=5))
    assert_same_bits(other_parameters, parameters)
    np.testing.assert_array_equal(readings, other_readings)


def test_arms_differ_from_row_to_row_and_from_seed_to_seed():
    parameters, _ = physics_of(World(seed=5))
    others, _ = physics_of(World(seed=6))
    for name in ("strand_damping_scale", "strand_friction", "armature_scale", "gain_scale", "tilt"):
        values = parameters[name]
        assert len(np.unique(values, axis=0)) == NUM_ENVS
        assert not np.any(values == others[name])


def test_a_controller_that_drives_away_is_evaluated_worse(evaluator, base_alone):
    away = evaluator.evaluate(lambda seen: np.ones((len(seen), ARM.num_cables), np.float32))
    assert np.all(away.position_error > base_alone.position_error)


def test_errors_are_means_over_the_scored_end(evaluator):
    world = World(seed=5)
    world.reset()
    errors = [np.asarray(world.step(nothing()).metrics["position_error"]) for _ in range(CONFIG.episode_steps)]
    evaluated = evaluator.evaluate()
    np.testing.assert_array_equal(evaluated.position_error, np.mean(errors[-CONFIG.scored_steps :], axis=0))
    np.testing.assert_array_equal(evaluated.position_trace, errors)


def test_a_row_that_diverges_is_not_valid_and_the_others_are_untouched(evaluator, base_alone):
    calls = []

    def act(seen):
        calls.append(0)
        actions = do_nothing(seen, ARM.num_cables)
        actions[1] = np.nan if len(calls) == 7 else 0.0
        return actions

    evaluated, others = evaluator.evaluate(act), [0, 2, 3]  # sound, all of them
    assert evaluated.is_valid.tolist() == [True, False, True, True] and base_alone.is_valid.all()
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(getattr(evaluated, quantity)[others], getattr(base_alone, quantity)[others])


def test_an_engine_evaluates_much_as_c_mujoco_does_and_leaves_the_neighbours_of_what_diverges_alone(base_alone):
    """Errors of arms that follow their commands; on the way the two engines differ as two integrators do."""
    targets = rows_of(bank(), range(NUM_ENVS))
    evaluator = Evaluator(ARM, CONFIG, targets, make_stepper(ARM, NUM_ENVS, ENGINE), 5)
    alone = evaluator.evaluate()
    assert alone.is_valid.all()
    np.testing.assert_allclose(alone.position_error, base_alone.position_error, rtol=0.0, atol=1e-3)

    def act(seen):
        return np.where(np.arange(NUM_ENVS)[:, None] == 1, np.nan, do_nothing(seen, ARM.num_cables))

    evaluated, others = evaluator.evaluate(act), [0, 2, 3]
    assert evaluated.is_valid.tolist() == [True, False, True, True]
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(getattr(evaluated, quantity)[others], getattr(alone, quantity)[others])


def test_progress_counts_every_step_of_every_arm(evaluator):
    counted = []
    evaluator.evaluate(advance=counted.append)
    assert sum(counted) == CONFIG.episode_steps * NUM_ENVS


def test_targets_that_come_too_late_are_told_apart():
    lengths = np.asarray(bank().base_lengths)
    times = np.array([float(ramp_time(ARM, row)) for row in lengths])
    middle = float(np.median(times))
    config = dataclasses.replace(CONFIG, latest_arrival=middle)
    assert arrives_in_time(ARM, config, lengths).tolist() == (times <= middle).tolist()
    assert 0 < np.sum(times <= middle) < len(times)


# --- comparison ---------------------------------------------------------------------------------------------------


def columns(num_late=1):
    """Columns of `ik/held_out.npz`: four targets a set, the last `num_late` of each too far for the motors."""
    targets = bank()
    lengths = np.array(targets.base_lengths)
    late = np.concatenate([np.arange(4 - num_late, 4), np.arange(8 - num_late, 8)]).astype(int)
    lengths[late] *= 100.0
    return {
        "target_set": np.repeat([0, 1], 4),
        "target": np.asarray(targets.target),
        "nominal_lengths": lengths,
        "learned_lengths": np.asarray(targets.base_lengths),
    }


@pytest.fixture(scope="module")
def compared():
    config = PolicyConfig(base="learned", environment=CONFIG)
    return compare_controllers(ARM, SettleConfig(), config, policy_that(0.0), columns(), seed=3)


def test_all_controllers_are_compared_on_both_sets_and_the_same_rows(compared):
    names = [controller_name(base) for base in BASES] + ["learned_ik+residual"]
    assert len(set(names)) == 7 and set(compared) == {
        (target_set, name) for target_set in TARGET_SETS for name in names
    }
    assert {len(evaluation.position_error) for evaluation, _ in compared.values()} == {3}
    assert {left_out for _, left_out in compared.values()} == {1}


def test_a_policy_that_does_nothing_equals_its_base_bit_for_bit(compared):
    for target_set in TARGET_SETS:
        assert_same_evaluation(compared[target_set, "learned_ik+residual"][0], compared[target_set, "learned_ik"][0])
        # The bases of these columns are the same where they are in time, and this environment has no feedback.
        assert_same_evaluation(compared[target_set, "nominal"][0], compared[target_set, "learned_ik"][0])
        assert_same_evaluation(compared[target_set, "learned_ik+integral"][0], compared[target_set, "learned_ik"][0])


def test_a_policy_that_drives_away_shows(compared):
    config = PolicyConfig(base="learned", environment=CONFIG)
    found = compare_controllers(ARM, SettleConfig(), config, policy_that(3.0), columns(), seed=3)
    for target_set in TARGET_SETS:
        assert_same_evaluation(found[target_set, "nominal"][0], compared[target_set, "nominal"][0])
        pair = found[target_set, "learned_ik+residual"][0], found[target_set, "learned_ik"][0]
        assert np.all(pair[0].position_error > pair[1].position_error)
