"""How XLA shall compile long chains of small bodies on a CPU."""

import functools
from collections.abc import Callable
from typing import Any

import jax

# XLA fuses the chain so that every link computes all links before it again, its time doubling with each: MJX's kinematics
# of 8 joints took 100 s to compile and 4 s to run a row; without fusion 12 s and 0.3 ms.
# XLA makes one function of a loop whose state is small, and LLVM needs minutes for one as long as a step of a few arms.
CPU_COMPILER_OPTIONS = {"xla_disable_hlo_passes": "fusion,small-while-loop-hoisting"}


def jit_of_chains(function: Callable[..., Any], **arguments: Any) -> Callable[..., Any]:
    """`jax.jit` of a function that holds such chains; asks for devices when it is first called, not before."""

    @functools.cache
    def compiled() -> Callable[..., Any]:
        return jax.jit(function, compiler_options=options_of_chains(), **arguments)

    return functools.wraps(function)(lambda *inputs: compiled()(*inputs))


def options_of_chains() -> dict[str, Any] | None:
    """Compiler options of this process's devices."""
    return CPU_COMPILER_OPTIONS if jax.default_backend() == "cpu" else None
