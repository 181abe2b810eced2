"""Small worlds for the tests of controllers: the two-segment arm, a few targets, short episodes."""

import dataclasses
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from arms import arm_named, over_rows, random_bends

from qjrl.control.arm_estimate import EstimateConfig
from qjrl.control.environment import ResidualEnv, residual_env
from qjrl.control.episode import Bank, EnvironmentConfig, StepOutcome, tasks_of
from qjrl.control.evaluation import _compiled
from qjrl.control.motors import DitherConfig, ResidualConfig
from qjrl.control.tip_correction import IntegralConfig
from qjrl.learning.ppo.environment import ACTOR_KEY, State, observation_sizes
from qjrl.learning.ppo.policy import Policy
from qjrl.robot import cable_lengths, forward_kinematics, joint_positions, strand_commands
from qjrl.robot.plant import PlantState
from qjrl.robot.verbs import Robot
from qjrl.simulation.control_period import substeps_of
from qjrl.simulation.engine import EngineConfig
from qjrl.simulation.engines import make_engine
from qjrl.simulation.stepping import MujocoStepper
from qjrl.xla_options import jit_of_chains

ARM = arm_named("qj_22")
NUM_ENVS = 4
CONFIG = EnvironmentConfig(
    episode_steps=24,
    latest_arrival=0.4,
    scored_time=0.06,
    estimate=EstimateConfig(acts=False),
    dither=DitherConfig(amplitude=0.0),
    integral=IntegralConfig(gain=0.0),
    residual=ResidualConfig(space="cables", bound=0.003, rate=0.01, lag=0.0),
)
ENGINE = EngineConfig("minimal", 0.005)


def bank(count=8, seed=0, share=0.15):
    """Targets near enough for short episodes, with the closed form's commands."""
    bends = random_bends(ARM, count, seed, share)
    return Bank(
        jnp.asarray(over_rows(forward_kinematics, ARM, bends)), jnp.asarray(over_rows(cable_lengths, ARM, bends))
    )


def rows_of(targets: Bank, rows) -> Bank:
    return Bank(targets.target[np.asarray(rows)], targets.base_lengths[np.asarray(rows)])


def random_actions(count, seed=0, num_envs=NUM_ENVS):
    return np.random.default_rng(seed).uniform(-1, 1, (count, num_envs, ARM.num_cables)).astype(np.float32)


def assert_same_bits(one, other):
    """Two pytrees, keys among them."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    leaves = zip(jax.tree.leaves_with_path(one), jax.tree.leaves(other), strict=True)
    for (path, left), right in leaves:
        np.testing.assert_array_equal(plain(left), plain(right), err_msg=jax.tree_util.keystr(path))


def plain(leaf) -> np.ndarray:
    is_key = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def rows_in(tree, rows):
    """Some arms of a pytree of arms, as plain arrays."""
    return jax.tree.map(lambda leaf: plain(leaf)[np.asarray(rows)], tree)


def policy_that(bias: float) -> Policy:
    """A policy whose action is tanh(bias) everywhere."""
    size, actions = actor_size(), ARM.num_cables
    head = np.concatenate([np.full(actions, bias), np.zeros(actions)]).astype(np.float32)
    layers = {"hidden_0": {"kernel": np.zeros((size, 2 * actions), np.float32), "bias": head}}
    ones = np.ones(size, np.float32)
    return Policy(layers, 0 * ones, ones, activation="tanh", observation_clip=10.0)


@cache
def actor_size() -> int:
    with jax.enable_x64(False):
        return observation_sizes(shared_env())[ACTOR_KEY]


# --- on the host --------------------------------------------------------------------------------------------------


class World:
    """Whole episodes on the host over C MuJoCo, arm i towards target i, float64: as they are evaluated, but to look into."""

    def __init__(self, config=CONFIG, targets: Bank | None = None, seed=0, robot: Robot = ARM):
        targets = rows_of(bank(), range(NUM_ENVS)) if targets is None else targets
        self.robot, self.config, self._functions = robot, config, _compiled(config)
        self.stepper = MujocoStepper(ARM, len(targets.target))
        rows = jnp.arange(len(targets.target))
        keys = jax.vmap(partial(jax.random.fold_in, jax.random.key(seed)))(rows)
        tasks = tasks_of(config, robot, targets)
        self.begun: Any = self._functions.begin(robot, tasks, keys, rows, jnp.zeros(len(rows), bool))

    def reset(self) -> dict[str, jax.Array]:
        """All arms at rest at home: the first observation."""
        home = np.asarray(joint_positions(self.robot, jnp.zeros((self.robot.num_segments, 2))))
        held = np.asarray(strand_commands(self.robot, jnp.zeros(self.robot.num_cables)))
        parameters = jax.tree.map(np.asarray, self.begun.parameters)
        self.stepper.reset(np.arange(self.stepper.num_sims), home, held, parameters)
        begun = dataclasses.replace(self.begun.state, key=jax.random.clone(self.begun.state.key))
        self.state, observation = self._functions.restart(self.robot, begun, self.stepper.read())
        return observation

    def step(self, action) -> StepOutcome:
        """One control period; action (arms, action size)."""
        action = jnp.asarray(action, self.state.control.residual.dtype)
        planned, rest_lengths = self._functions.command(self.robot, self.state, action)
        self.stepper.step(np.asarray(rest_lengths), substeps_of(self.config.control_period, self.stepper.timestep))
        outcome = self._functions.observe(self.robot, planned, self.seen)
        self.state = outcome.state
        return outcome

    @property
    def commands(self) -> np.ndarray:
        """(arms, cables) what the motors hold [m]."""
        return np.array(self.state.control.command)

    @property
    def seen(self) -> PlantState:
        """Of the physics, now."""
        return self.stepper.read()


def nothing(num_envs=NUM_ENVS) -> np.ndarray:
    return np.zeros((num_envs, ARM.num_cables))


# --- as one program -----------------------------------------------------------------------------------------------

# Compiling `step` takes half a minute: one environment and one number of arms for all tests.


@cache
def shared_env() -> ResidualEnv:
    with jax.enable_x64(True):  # whoever asks first
        return residual_env(ARM, CONFIG, bank(), make_engine(ARM, ENGINE))


def keys_of(seed=0, count=NUM_ENVS) -> jax.Array:
    return jax.random.split(jax.random.key(seed), count)


def reset(env: ResidualEnv, keys: jax.Array, spread=False) -> State:
    with jax.enable_x64(False):
        return (_spread if spread else _reset)(env, keys)


def step(env: ResidualEnv, state: State, actions) -> State:
    with jax.enable_x64(False):
        return _step(env, state, np.asarray(actions, np.float32))


_reset = jit_of_chains(lambda env, keys: env.reset(keys))
_spread = jit_of_chains(lambda env, keys: env.spread(keys))
_step = jit_of_chains(lambda env, state, actions: env.step(state, actions))
