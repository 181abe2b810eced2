"""A toy kind of forward model: a linear correction of the nominal configuration. It proves what a kind must offer."""

import contextlib
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from qjrl.config import Range, configuration
from qjrl.robot.model_coordinates import model_inputs, model_pose, model_targets
from qjrl.robot.model_kind import ModelKind
from qjrl.robot.model_kinds import MODEL_KINDS


@configuration
class RidgeConfig:
    kind: Literal["ridge"] = "ridge"
    strength: Annotated[float, Range(above=0.0)] = 1e-3
    held_out: Annotated[float, Range(above=0.0, high=0.5)] = 0.1


@struct.dataclass
class RidgeModel:
    slopes: Any  # (inputs + 1, answers)
    config: RidgeConfig = struct.field(pytree_node=False)


@struct.dataclass(eq=False)
class RidgePose:
    robot: Any
    slopes: Any

    def __call__(self, lengths):
        answer = (with_one(model_inputs(self.robot, "corrected", lengths)) @ self.slopes).astype(lengths.dtype)
        return model_pose(self.robot, "corrected", lengths, answer)


def with_one(inputs):
    return jnp.append(inputs, 1.0)


def fit_ridge(robot, config, split, seed, directory):
    del seed, directory
    rows = jnp.asarray(split[0]["cable_lengths"])
    inputs = np.asarray(jax.vmap(lambda row: with_one(model_inputs(robot, "corrected", row)))(rows))
    normal = inputs.T @ inputs + config.strength * np.eye(inputs.shape[1])
    slopes = np.linalg.solve(normal, inputs.T @ np.asarray(model_targets(robot, "corrected", split[0])))
    return RidgeModel(jnp.asarray(slopes), config), {"strength": config.strength}


RIDGE = ModelKind(
    config=RidgeConfig,
    fit=fit_ridge,
    on_robot=lambda robot, model: RidgePose(robot, model.slopes),
    to_arrays=lambda model: {"slopes": model.slopes},
    from_arrays=lambda config, arrays: RidgeModel(jnp.asarray(arrays["slopes"]), config),
    names=("slopes",),
)


@contextlib.contextmanager
def registered() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(MODEL_KINDS, "ridge", RIDGE)
        yield
