"""The kinds of forward models: one record each, by the name that the configuration gives as `forward_model.kind`."""

from typing import Annotated, Any

from qjrl.config import OneOf
from qjrl.robot.continuum_arm.grey_model import GREY, GREY_GAUSSIAN_PROCESS
from qjrl.robot.gaussian_process_model import GAUSSIAN_PROCESS
from qjrl.robot.model_kind import FittedModel, ModelKind
from qjrl.robot.network_fitting import NETWORK

MODEL_KINDS: dict[str, ModelKind] = {
    "network": NETWORK,
    "gaussian_process": GAUSSIAN_PROCESS,
    "grey": GREY,
    "grey_gaussian_process": GREY_GAUSSIAN_PROCESS,
}
"""The first is meant where no kind is said."""

ModelConfig = Annotated[Any, OneOf(lambda: [kind.config for kind in MODEL_KINDS.values()])]
"""The configuration of any of them: the group `forward_model`."""


def model_kind_of(model: FittedModel) -> ModelKind:
    """The record of a fitted model's kind."""
    return MODEL_KINDS[model.config.kind]
