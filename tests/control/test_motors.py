import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import arm_named, over_rows, random_bends

from qjrl.control import motors
from qjrl.robot import bends_from_cables, cable_lengths

ARMS = ["qj_2222", "rolling_312"]
PERIOD = 0.02


def base_commands(arm, count=6, seed=0):
    return over_rows(cable_lengths, arm, random_bends(arm, count, seed))


@pytest.mark.parametrize("name", ARMS)
def test_the_ramp_is_straight_in_bend_space_and_stays_within_the_limits(name):
    arm = arm_named(name)
    bends = random_bends(arm, 6)
    shares = jnp.array([0.0, 0.25, 0.5, 0.9, 1.0, 3.0])

    def on_the_way(arm, bends):
        base = cable_lengths(arm, bends)
        times = shares * motors.ramp_time(arm, base)
        return jax.vmap(lambda time: bends_from_cables(arm, motors.ramped_base(arm, base, time)))(times)

    found = over_rows(on_the_way, arm, bends)
    expected = np.minimum(shares, 1.0)[None, :, None, None] * bends[:, None]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.linalg.norm(found, axis=-1).max() <= np.sin(float(arm.bend_limit) / 2.0) + 1e-12


def test_the_longest_cable_sets_the_ramps_duration():
    arm = arm_named("qj_2222")
    base = jnp.array([0.0, 0.01, -0.0628, 0.02, 0.0, 0.0, 0.0, 0.0])
    speed = float(arm.motor_speed)
    assert float(motors.ramp_time(arm, base)) == pytest.approx(0.0628 / speed)
    assert float(motors.ramp_time(arm, jnp.zeros(8))) == 0.0
    np.testing.assert_array_equal(motors.ramped_base(arm, jnp.zeros(8), jnp.zeros(())), np.zeros(8))
    halfway = motors.ramped_base(arm, base, jnp.asarray(0.0314 / speed))
    np.testing.assert_allclose(halfway, np.asarray(base) / 2, atol=1e-15)


def test_the_residual_by_hand_numbers():
    config = motors.ResidualConfig(lag=0.0, rate=0.01, bound=0.0005)
    residual = jnp.array([0.0, 0.0, 0.0004, -0.0005, 0.0005])
    action = jnp.array([0.0, 0.2, 1.0, 7.0, -7.0])
    moved = motors.move_residual(config, residual, action, PERIOD)
    np.testing.assert_allclose(moved, [0.0, 0.0001, 0.0005, -0.0003, 0.0003], atol=1e-18)


def test_the_residual_never_leaves_its_bound_nor_exceeds_its_rate():
    config = motors.ResidualConfig(lag=0.0)
    actions = np.random.default_rng(0).normal(2.0, 5.0, (200, 8))
    residual = jnp.zeros(8)
    move = jax.jit(lambda residual, action: motors.move_residual(config, residual, action, PERIOD))
    for action in actions:
        moved = move(residual, action)
        assert np.abs(moved - residual).max() <= config.rate * PERIOD * (1 + 1e-12)
        assert np.abs(moved).max() <= config.bound
        residual = moved
    assert float(jnp.max(residual)) == config.bound


def test_the_residual_reaches_the_actions_offset_and_stays_there():
    config = motors.ResidualConfig(bound=0.001, rate=0.01, lag=0.0)
    action, residual = jnp.array([0.5, -1.0, 0.0]), jnp.zeros(3)
    for _ in range(10):
        residual = motors.move_residual(config, residual, action, PERIOD)
    np.testing.assert_allclose(residual, 0.001 * action, atol=1e-18)
    np.testing.assert_array_equal(motors.move_residual(config, residual, action, PERIOD), residual)


def test_a_residual_of_the_tip_is_six_numbers_and_one_of_the_cables_as_many_as_they_are():
    arm, correction = arm_named("qj_2222"), jnp.arange(48.0).reshape(8, 6)
    tip, cables = motors.ResidualConfig(space="tip"), motors.ResidualConfig(space="cables")
    assert (motors.action_size(tip, arm), motors.action_size(cables, arm)) == (6, 8)
    np.testing.assert_allclose(motors.residual_lengths(tip, jnp.eye(6)[2], correction), correction[:, 2])
    np.testing.assert_array_equal(motors.residual_lengths(cables, jnp.ones(8), correction), np.ones(8))


@pytest.mark.parametrize("name", ARMS)
def test_base_and_residual_together_never_exceed_the_motors_speed(name):
    """The residual moves at its full rate, in both directions, while the base is ramped in at motor speed."""
    arm, config = arm_named(name), motors.ResidualConfig(lag=0.0, rate=0.0075, bound=0.01)
    base = jnp.asarray(base_commands(arm, 1)[0])
    action = jnp.asarray(np.where(np.arange(arm.num_cables) % 3 == 0, -1.0, 1.0) * np.sign(base))

    def one(carry, step):
        residual, command = carry
        residual = motors.move_residual(config, residual, action, PERIOD)
        desired = motors.ramped_base(arm, base, (step + 1) * PERIOD) + residual
        command = motors.limit_speed(arm, command, desired, PERIOD)
        return (residual, command), (command, desired)

    _, (commands, desired) = jax.lax.scan(one, (jnp.zeros_like(base), jnp.zeros_like(base)), jnp.arange(400))
    steps = np.abs(np.diff(np.concatenate([np.zeros((1, arm.num_cables)), commands]), axis=0))
    assert steps.max() <= arm.motor_speed * PERIOD * (1 + 1e-12)
    assert np.abs(commands - desired).max() > 1e-3  # the limiter did bind
    np.testing.assert_allclose(commands[-1], base + config.bound * action, atol=1e-12)  # and nothing was lost by it


def test_the_dither_swings_first_against_the_way_the_cables_came():
    config, base = motors.DitherConfig(half_period=0.04), jnp.array([0.03, -0.02, 0.0])
    times = jnp.array([-0.01, 0.0, 0.02, 0.04, 0.08])
    added = jax.vmap(lambda time: motors.dither(config, jnp.array(0.001), base, time))(times)
    sign = np.array([0.0, -1.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(added, 0.001 * sign[:, None] * np.array([1.0, -1.0, 0.0]), atol=1e-15)


def test_the_swings_die_away_and_grow_by_what_moves_the_cables():
    config, still = motors.DitherConfig(amplitude=0.0005, growth=2.0, decay=0.2, lifetime=0.5), jnp.zeros(3)
    arrived = jnp.zeros(())
    alone = motors.next_swing(config, jnp.array(config.amplitude), jnp.array(4e-4), still, arrived, PERIOD)
    assert float(alone) == pytest.approx(4e-4 * np.exp(-PERIOD / 0.2), rel=1e-12)
    moved = motors.next_swing(
        config, jnp.array(config.amplitude), jnp.array(4e-4), jnp.array([1e-5, -2e-5, 0.0]), arrived, PERIOD
    )
    assert float(moved - alone) == pytest.approx(2.0 * 2e-5, rel=1e-9)
    for waited, largest in ((-0.3, 0.0005), (0.0, 0.0005), (1.0, 0.0005 * np.exp(-2.0))):
        swing = motors.next_swing(
            config,
            jnp.array(config.amplitude),
            jnp.array(4e-4),
            jnp.array([0.0, 0.0006, 0.0]),
            jnp.array(waited),
            PERIOD,
        )
        assert float(swing) == pytest.approx(largest, rel=1e-12)


def test_an_answer_that_follows_the_swings_hardly_feeds_them():
    """A step of what is added is smoothed to all of itself in the end; one that alternates, to next to nothing."""
    config, shares = motors.DitherConfig(decay=0.3), []
    for added in (np.full(100, 1e-3), 1e-3 * (-1.0) ** np.arange(100)):
        trend, ways = jnp.zeros(1), []
        for value in added:
            following = motors.smoothed(config, trend, jnp.array([value]), PERIOD)
            ways.append(abs(float(following[0] - trend[0])))
            trend = following
        shares.append(sum(ways) / np.abs(np.diff(added, prepend=0.0)).sum())
    assert shares[0] == pytest.approx(1.0, abs=2e-3) and shares[1] < 0.07


def test_the_default_dither_is_soon_within_the_motors_speed():
    """Until then it is shortened: by a fifth of a second, the motors follow the swings."""
    arm, config = arm_named("qj_2222"), motors.DitherConfig()
    swing = config.amplitude * np.exp(-0.2 / config.decay) * (1.0 + np.exp(-config.half_period / config.decay))
    assert swing <= arm.motor_speed * config.half_period


def test_a_lagging_residual_closes_the_gap_exponentially():
    config, action = motors.ResidualConfig(bound=0.002, rate=1.0, lag=0.5), jnp.array([1.0, -0.5])
    path = [jnp.array([0.0, 0.001])]
    for _ in range(50):
        path.append(motors.move_residual(config, path[-1], action, PERIOD))
    passed = np.exp(-PERIOD * np.arange(1, 51) / 0.5)[:, None]
    wanted = 0.002 * np.array([1.0, -0.5])
    np.testing.assert_allclose(path[1:], wanted + (np.array([0.0, 0.001]) - wanted) * passed, atol=1e-15)


def test_an_action_for_what_lacks_takes_the_residual_to_where_nothing_lacks():
    config = motors.ResidualConfig(lag=0.0, bound=0.002, rate=1.0)
    residual, lacking = jnp.array([5e-4, 0, 0, 0, 0, 0]), jnp.array([3e-4, -1e-4, 0, 0, 1e-5, 0])
    action = residual / config.bound + motors.action_of(config, lacking, jnp.zeros((8, 6)))
    np.testing.assert_allclose(motors.move_residual(config, residual, action, PERIOD), residual + lacking, atol=1e-15)


def test_a_command_within_reach_is_reached_in_one_period():
    arm = arm_named("qj_2222")
    largest = float(arm.motor_speed) * PERIOD
    command, desired = jnp.zeros(3), jnp.array([0.4 * largest, -largest, 3.0 * largest])
    np.testing.assert_allclose(motors.limit_speed(arm, command, desired, PERIOD), [0.4 * largest, -largest, largest])
