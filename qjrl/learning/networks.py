"""The regression network of paper 000: Fourier features, then residual blocks."""

from typing import Annotated

import jax.numpy as jnp
from flax import linen
from jaxtyping import Array, Float

from qjrl.config import Range, configuration


@configuration
class NetworkConfig:
    """Size of a `FourierResidualNetwork`. Defaults: ours, for corrections of the closed form; the paper's (section 4) are
    `conf/forward_model/paper.yaml`."""

    width: Annotated[int, Range(1, 8192)] = 256
    """Units of every hidden layer. Ours: 0.114 mm at 10,000 rows, 0.157 with 128."""
    num_blocks: Annotated[int, Range(0, 64)] = 2
    """Residual blocks, two dense layers each (ours)."""
    num_frequencies: Annotated[int, Range(0, 16)] = 0
    """Fourier features sin, cos(2^j pi x), j = 0 .. num_frequencies - 1; 0: the input alone. Ours: the corrections are smooth;
    0 and 1 gave 0.114 and 0.119 mm at 10,000 rows."""
    zero_output: bool = True
    """Start with an output layer of zeros: the untrained network predicts the mean target exactly; as a correction, none."""


class FourierResidualNetwork(linen.Module):
    """x -> dense -> num_blocks times x + W2 gelu(W1 x) -> gelu -> linear, in float32.

    Source: paper 000, forward model, as read in the spec, section 4.
    """

    config: NetworkConfig
    output_size: int

    @linen.compact
    def __call__(self, inputs: Float[Array, "*batch n"]) -> Float[Array, "*batch outputs"]:
        """(..., n) in [-1, 1] -> (..., output_size)."""
        width = self.config.width
        hidden = fourier_features(inputs.astype(jnp.float32), self.config.num_frequencies)
        hidden = linen.Dense(width, name="input")(hidden)  # (..., width)
        for block in range(self.config.num_blocks):
            inner = linen.gelu(linen.Dense(width, name=f"block_{block}_inner")(hidden))
            hidden = hidden + linen.Dense(width, name=f"block_{block}_outer")(inner)
        kernel_init = linen.initializers.zeros if self.config.zero_output else linen.initializers.lecun_normal()
        return linen.Dense(self.output_size, kernel_init=kernel_init, name="output")(linen.gelu(hidden))


def fourier_features(inputs: Float[Array, "*batch n"], num_frequencies: int) -> Float[Array, "*batch features"]:
    """The inputs beside sin and cos(2^j pi x), j = 0 .. num_frequencies - 1.

    Args:
        inputs: (..., n), meant for [-1, 1].
    Returns:
        (..., n (1 + 2 num_frequencies)).
    """
    angles = [jnp.pi * 2.0**j * inputs for j in range(num_frequencies)]
    waves = [wave(angle) for angle in angles for wave in (jnp.sin, jnp.cos)]
    return jnp.concatenate([inputs, *waves], axis=-1)
