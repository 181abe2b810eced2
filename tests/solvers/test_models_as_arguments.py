"""A model is an argument of what is compiled: another of the same size compiles nothing, and another kind does."""

import contextlib
import functools
import inspect
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from poses import reachable
from settled import ARM

from qjrl.config import ConfigError
from qjrl.control.path.inversion import PathInversionConfig, invert_path
from qjrl.learning.fitting import FitConfig, FittedNetwork
from qjrl.learning.networks import NetworkConfig
from qjrl.robot.forward_model import ForwardModelConfig, make_network, pose_function
from qjrl.robot.network_model import NetworkModel
from qjrl.robot.pose_model import ClosedForm, PlainFunction, as_model, model_poses
from qjrl.solvers import AdamConfig, LeastSquaresConfig, draw_candidates, solve_adam, solve_least_squares
from qjrl.solvers.least_squares import RoundConfig

LEAST_SQUARES = LeastSquaresConfig(
    rounds=(RoundConfig(2, 10),), nearest_iterations=4, least_tension=0.0, num_candidates=64, batch_size=8
)
ADAM = AdamConfig(iterations=3, num_restarts=2, num_candidates=16, num_retries=0, batch_size=8)
TARGETS = reachable(ARM, 4)
COMPILED = "/jax/core/compile/backend_compile_duration"


def network_model(seed: int, width: int = 8, epochs: int = 60):
    """A network that was not fitted, near the closed form."""
    config = ForwardModelConfig(network=NetworkConfig(width, 1, zero_output=False), fit=FitConfig(epochs=epochs))
    network, size = make_network(ARM, config), ARM.num_cables
    parameters = network.init(jax.random.key(seed), jnp.zeros((1, size), jnp.float32))["params"]
    zeros = jnp.zeros(size, jnp.float32)
    return pose_function(ARM, NetworkModel(FittedNetwork(parameters, zeros, zeros + 0.01), config))


@contextlib.contextmanager
def compilations() -> Iterator[list[str]]:
    """What is compiled meanwhile."""
    found: list[str] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == COMPILED:
            found.append(str(kwargs))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def by_least_squares(model):
    return solve_least_squares(ARM, TARGETS, config=LEAST_SQUARES, candidates=CANDIDATES, model=model)


def by_adam(model):
    return solve_adam(ARM, TARGETS, model, ADAM)


CANDIDATES = draw_candidates(ARM, LEAST_SQUARES)


@pytest.mark.parametrize("solve", [by_least_squares, by_adam])
def test_models_of_the_same_size_share_what_is_compiled_and_give_their_own_answers(solve):
    models = [network_model(0), network_model(1), network_model(2, epochs=7)]
    with compilations() as first:
        answers = [solve(models[0])]
    assert first
    with compilations() as others:
        answers += [solve(model) for model in models[1:]]
    assert not others
    assert np.abs(np.asarray(answers[0].cable_lengths - answers[1].cable_lengths)).max() > 1e-5
    for model, answer in zip(models, answers, strict=True):
        poses = model_poses(model, answer.cable_lengths)
        np.testing.assert_allclose(
            np.linalg.norm(poses[:, :3] - TARGETS[:, :3], axis=1), answer.position_error, atol=1e-7
        )


def test_a_model_of_another_size_is_compiled():
    model_poses(network_model(0), CANDIDATES.coordinates[:4])
    with compilations() as others:
        model_poses(network_model(1), CANDIDATES.coordinates[:4])
    assert not others
    with compilations() as others:
        model_poses(network_model(0, width=9), CANDIDATES.coordinates[:4])
    assert others


def test_a_plain_function_is_taken_and_answers_as_the_pytree_does():
    model = network_model(3)
    plain, answer = by_adam(lambda lengths: model(lengths)), by_adam(model)
    np.testing.assert_allclose(plain.cable_lengths, answer.cable_lengths, atol=1e-7)
    np.testing.assert_array_equal(plain.status, answer.status)


def test_what_is_a_pytree_stays_one_a_function_is_wrapped_and_the_rest_is_refused():
    model, closed_form = network_model(0), ClosedForm(ARM)
    assert as_model(model) is model and as_model(closed_form) is closed_form and as_model(None) is None
    partial = jax.tree_util.Partial(lambda shift, lengths: closed_form(lengths + shift), 1e-3)
    assert as_model(partial) is partial
    for function in (lambda lengths: closed_form(lengths), functools.partial(closed_form)):
        assert as_model(function) == PlainFunction(function) and not jax.tree.leaves(as_model(function))


@pytest.mark.parametrize("wrong", [3, "network", np.zeros(9)], ids=str)
def test_what_cannot_be_called_is_refused_in_one_line(wrong):
    unchecked: Any = inspect.unwrap(as_model)  # without the types that tests hold every call against
    with pytest.raises(ConfigError, match=r"^model: got .*, allowed: what is called with cable lengths"):
        unchecked(wrong)


def test_the_closed_form_as_a_model_is_the_closed_form():
    lengths = model_lengths()
    np.testing.assert_array_equal(model_poses(ClosedForm(ARM), lengths), model_poses(pose_function(ARM, None), lengths))
    named, meant = by_least_squares(ClosedForm(ARM)), by_least_squares(None)
    assert np.all(named.converged) and np.all(meant.converged)
    poses = [model_poses(ClosedForm(ARM), one.cable_lengths) for one in (named, meant)]
    np.testing.assert_allclose(poses[0][:, :3], poses[1][:, :3], atol=2e-5)


def model_lengths() -> np.ndarray:
    return 1e-3 * np.random.default_rng(0).normal(size=(4, ARM.num_cables))


def test_a_model_may_be_compiled_as_it_is_mapped_and_differentiated():
    model = network_model(0)
    row = jnp.asarray(model_lengths()[0])
    np.testing.assert_allclose(jax.jit(model)(row), model(row), atol=1e-9)
    slopes = jax.jit(jax.grad(lambda model: jnp.sum(model(row) ** 2)))(model)
    assert jax.tree.structure(slopes) == jax.tree.structure(model)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def test_paths_on_models_of_the_same_size_share_what_is_compiled():
    from qjrl.control.path.paths import PosePath

    pose = model_poses(network_model(0), 1e-4 * np.arange(17)[:, None] * np.ones(ARM.num_cables))
    path = PosePath(pose, np.linspace(0.0, 0.016, 17), "position", lambda distances: pose, "track.path")
    config = PathInversionConfig(num_starts=2)
    found = [invert_path(ARM, network_model(0), path, config)]
    with compilations() as others:
        found.append(invert_path(ARM, network_model(1), path, config))
    assert not others and not np.array_equal(found[0].lengths.c, found[1].lengths.c)
