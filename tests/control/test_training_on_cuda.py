"""A whole iteration of training, lowered for a GPU without one: it never asks the host, and computes in float32."""

import functools
import re

import jax
import numpy as np
import pytest
from customary import customary_ppo
from worlds import NUM_ENVS, shared_env

from qjrl.learning.ppo.iteration import begin, iterate, make_plan
from qjrl.learning.ppo.mesh import device_mesh

CONFIG = customary_ppo(unroll_length=2, num_epochs=1, num_minibatches=2, actor_layers=(8,), critic_layers=(8,))


@pytest.fixture(scope="module")
def program() -> str:
    """StableHLO of an iteration for CUDA."""
    with jax.enable_x64(False):
        env, mesh = shared_env(), device_mesh()
        plan = make_plan(env, CONFIG, NUM_ENVS, 2, mesh)
        trainer = jax.eval_shape(functools.partial(begin, plan), env, np.uint32(0))
        leaves, structure = jax.tree.flatten((env, trainer))
        of_leaves = jax.jit(lambda leaves: iterate(plan, *jax.tree.unflatten(structure, leaves)))
        exported = jax.export.export(of_leaves, platforms=["cuda"])(leaves)
    assert exported.platforms == ("cuda",)
    return exported.mlir_module()


def test_an_iteration_lowers_for_cuda_as_one_program_that_never_asks_the_host(program):
    operations = set(re.findall(r"stablehlo\.(\w+)", program))
    assert {"while", "dot_general", "gather"} <= operations
    assert not operations & {"infeed", "outfeed", "send", "recv"}
    assert not re.findall(r"custom_call @(\S*callback\S*)", program)


def test_all_its_numbers_are_of_32_bits(program):
    assert not re.findall(r"tensor<[^>]*f64>", program)
