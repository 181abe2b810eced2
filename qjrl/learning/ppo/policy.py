"""The trained policy by itself: what evaluation, comparison and export need, without the trainer and without brax."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from qjrl.artifacts import ArtifactError
from qjrl.learning.parameters import load_parameters, save_parameters

ACTIVATIONS = {"swish": jax.nn.swish, "elu": jax.nn.elu, "tanh": jnp.tanh, "relu": jax.nn.relu}


@struct.dataclass
class Policy:
    """An actor and the statistics that normalise its observation, all float32."""

    layers: Any
    """hidden_0, hidden_1, ... -> kernel (n, m) and bias (m,); the last gives mean and scale of every action."""
    mean: Any
    """(n,) of the observation."""
    std: Any
    """(n,) of the observation."""
    activation: str = struct.field(pytree_node=False)
    observation_clip: float = struct.field(pytree_node=False)


def deterministic_action(policy: Policy, observation: Any) -> jax.Array:
    """The mode of the policy: tanh of the mean.

    Args:
        observation: (..., n), the actor's.
    Returns:
        (..., action_size) in [-1, 1], float32.
    """
    clip = policy.observation_clip
    hidden = jnp.clip((jnp.asarray(observation, jnp.float32) - policy.mean) / policy.std, -clip, clip)
    for index in range(len(policy.layers)):
        layer = policy.layers[f"hidden_{index}"]
        hidden = (hidden if index == 0 else ACTIVATIONS[policy.activation](hidden)) @ layer["kernel"] + layer["bias"]
    return jnp.tanh(hidden[..., : hidden.shape[-1] // 2])


def moderated(policy: Policy, share: float) -> Policy:
    """The policy whose actions have `share` of the mean, before the tanh; its scales stay."""
    name = f"hidden_{len(policy.layers) - 1}"
    bias = np.asarray(policy.layers[name]["bias"])
    factor = np.where(np.arange(len(bias)) < len(bias) // 2, share, 1.0).astype(np.float32)
    last = {key: np.asarray(value) * factor for key, value in policy.layers[name].items()}
    return dataclasses.replace(policy, layers={**policy.layers, name: last})


def save_policy(path: str | Path, policy: Policy) -> None:
    """Writes `path`.npz and `path`.json."""
    arrays = {"layers": policy.layers, "mean": policy.mean, "std": policy.std}
    description = {"activation": policy.activation, "observation_clip": policy.observation_clip}
    sizes = {"observation_size": policy.mean.shape[0], "num_layers": len(policy.layers)}
    save_parameters(path, arrays, {"format": 1, "kind": "tanh_policy", **description, **sizes})


def load_policy(path: str | Path) -> Policy:
    """Reads what `save_policy` wrote; the arrays are numpy, on the host.

    Raises:
        ArtifactError: missing, damaged, or no policy.
    """
    kinds, names = {"activation": str, "observation_clip": int | float}, ("layers", "mean", "std")
    tree, description = load_parameters(path, kinds, names)
    if description["activation"] not in ACTIVATIONS:
        allowed = ", ".join(ACTIVATIONS)
        raise ArtifactError(f"{path}.json: activation: got '{description['activation']}', allowed: {allowed}")
    arrays = {name: tree[name] for name in names}
    return Policy(**arrays, activation=description["activation"], observation_clip=description["observation_clip"])
