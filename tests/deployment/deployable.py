"""A run directory with a data set and a model of the two-segment arm, ready to be exported; the network is not trained."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from settled import ARM, settled_rows

from qjrl import artifacts, pipeline
from qjrl.config import as_mapping, conf_folder, read_yaml
from qjrl.deployment.compact_ik import CompactIKConfig
from qjrl.deployment.export import ExportConfig
from qjrl.deployment.parity import ParityConfig
from qjrl.learning.fitting import FittedNetwork
from qjrl.learning.networks import NetworkConfig
from qjrl.provenance import provenance
from qjrl.robot import robot_hash
from qjrl.robot.forward_model import ForwardModel, ForwardModelConfig, make_network, save_forward_model

HASH = robot_hash(ARM)
CONFIG = ExportConfig(
    onnx=False, ik=CompactIKConfig(num_candidates=256, num_starts=2), parity=ParityConfig(num_random=32)
)


def untrained_model(form: Any = "corrected") -> ForwardModel:
    """Random weights; what it answers is of the size of real corrections, or of real poses."""
    config = ForwardModelConfig(
        form, NetworkConfig(width=16, num_blocks=1, num_frequencies=2, zero_output=False), held_out=0.25
    )
    network = make_network(ARM, config)
    parameters = jax.jit(network.init)(jax.random.key(0), jnp.zeros((1, ARM.num_cables), jnp.float32))["params"]
    size = network.output_size
    return ForwardModel(
        FittedNetwork(parameters, jnp.zeros(size, jnp.float32), jnp.full(size, 0.02, jnp.float32)), config
    )


def make_run(directory: Path, model: ForwardModel) -> Path:
    """`dataset/` and `forward_model/`, marked as done."""
    rows = settled_rows(32)
    artifacts.append_shard(directory / "dataset", rows, HASH)
    artifacts.mark_done(directory / "dataset", robot_hash=HASH)
    dataset = artifacts.done_marker(directory / "dataset") or {}
    folder = directory / "forward_model"
    save_forward_model(folder / "model", ARM, model)
    artifacts.write_json(folder / artifacts.PROVENANCE, provenance({}, 0, None))
    artifacts.mark_done(folder, robot_hash=HASH, inputs={"sample": dataset["output_hash"]})
    return directory


def run_export(directory: Path, **changes: Any) -> Path:
    """The stage, as the command would run it."""
    tree = {
        "name": "tiny",
        "seed": 0,
        "stages": ["export"],
        "robot": read_yaml(conf_folder() / "robot" / "qj_22.yaml"),
        "export": as_mapping(dataclasses.replace(CONFIG, **changes)),
    }
    module = pipeline.STAGES["export"].load()
    kept = {field.name: tree[field.name] for field in dataclasses.fields(module.Config)}
    pipeline.run(["export"], {"export": pipeline.build(module.Config, kept)}, directory)
    return directory / "export"
