import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.config import shipped
from qjrl.learning.networks import FourierResidualNetwork, NetworkConfig, fourier_features
from qjrl.robot.forward_model import ForwardModelConfig

SMALL = NetworkConfig(width=16, num_blocks=2, num_frequencies=3, zero_output=False)


def test_fourier_features_are_sines_and_cosines_of_doubled_frequencies():
    """x = 1/4: 2^0 pi x = 45 degrees, 2^1 pi x = 90 degrees."""
    half = np.sqrt(0.5)
    features = fourier_features(jnp.float32([0.25]), num_frequencies=2)
    assert features == pytest.approx([0.25, half, half, 1, 0], abs=1e-6)


def test_without_frequencies_the_input_is_left_alone():
    assert fourier_features(jnp.float32([0.25, 1]), num_frequencies=0).tolist() == [0.25, 1]


def test_the_paper_s_network_has_the_size_that_it_prints():
    network = FourierResidualNetwork(shipped(ForwardModelConfig, "forward_model/paper").network, output_size=9)
    shapes = jax.eval_shape(network.init, jax.random.key(0), jnp.zeros((1, 8)))["params"]
    kernels = {name: layer["kernel"].shape for name, layer in shapes.items()}
    assert kernels["input"] == (8 * (1 + 2 * 6), 512)
    assert kernels["output"] == (512, 9)
    assert sorted(kernels.values()).count((512, 512)) == 12  # six blocks of two


def test_the_network_equals_its_formula():
    network = FourierResidualNetwork(SMALL, output_size=2)
    inputs = jax.random.uniform(jax.random.key(0), (5, 3), jnp.float32, -1, 1)
    parameters = jax.jit(network.init)(jax.random.key(1), inputs)["params"]

    def dense(name, x):
        return x @ parameters[name]["kernel"] + parameters[name]["bias"]

    hidden = dense("input", fourier_features(inputs, 3))
    for block in range(2):
        hidden = hidden + dense(f"block_{block}_outer", jax.nn.gelu(dense(f"block_{block}_inner", hidden)))
    expected = dense("output", jax.nn.gelu(hidden))
    assert jax.jit(network.apply)({"params": parameters}, inputs) == pytest.approx(np.asarray(expected), abs=1e-5)


def test_a_zero_output_layer_predicts_zero():
    network = FourierResidualNetwork(NetworkConfig(width=16, num_blocks=1, zero_output=True), output_size=4)
    inputs = jnp.ones((3, 8))
    answer = network.apply(jax.jit(network.init)(jax.random.key(0), inputs), inputs)
    assert np.array_equal(np.asarray(answer), np.zeros((3, 4)))


def test_float64_inputs_are_answered_in_float32():
    network = FourierResidualNetwork(SMALL, output_size=2)
    inputs = jnp.zeros((1, 3), jnp.float64)
    parameters = jax.jit(network.init)(jax.random.key(0), inputs)
    leaves = [*jax.tree.leaves(parameters), network.apply(parameters, inputs)]
    assert {leaf.dtype for leaf in leaves} == {jnp.dtype(jnp.float32)}
