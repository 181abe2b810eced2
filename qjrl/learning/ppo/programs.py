"""The compiled programs of a training; trainings of the same plan share them."""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from qjrl.learning.ppo import iteration
from qjrl.learning.ppo.environment import Env
from qjrl.learning.ppo.evidence import evidence_of
from qjrl.learning.ppo.iteration import Plan
from qjrl.learning.ppo.mesh import ENVS, on_host
from qjrl.learning.ppo.trainer_state import TrainerState
from qjrl.xla_options import jit_of_chains

Replay = Callable[[], dict[str, np.ndarray]]
"""What the envs were doing that diverged in an iteration."""


@dataclasses.dataclass(frozen=True)
class Iterated:
    """What an iteration leaves."""

    trainer: TrainerState
    metrics: dict[str, jax.Array]
    replay: Replay
    collecting_seconds: float | None
    """None where collecting and learning are one program."""


@dataclasses.dataclass(frozen=True)
class Programs:
    """All functions of `iteration`, compiled."""

    begin: Callable[..., TrainerState]
    """(env, seed) -> the untrained state."""
    collect: Callable[..., Any]
    learn: Callable[..., Any]
    iterate: Callable[..., Any]
    """Both at once."""
    store: Callable[..., Any]
    """Of DAgger, see `iteration.storing`."""
    are_apart: bool
    """Whether collecting and learning are two programs."""

    def run_iteration(self, env: Env, trainer: TrainerState) -> Iterated:
        """One iteration of PPO; the devices may still be at it."""

        def replay() -> dict[str, np.ndarray]:
            return self.replay(env, trainer, iteration.EXPLORES)

        if not self.are_apart:
            following, metrics = self.iterate(env, trainer)
            return Iterated(following, metrics, replay, None)
        start = time.perf_counter()
        collected = jax.block_until_ready(self.collect(env, trainer, np.float32(iteration.EXPLORES)))
        collecting = time.perf_counter() - start
        following, metrics = self.learn(*collected)
        return Iterated(following, metrics, replay, collecting)

    def replay(self, env: Env, trainer: TrainerState, around: float) -> dict[str, np.ndarray]:
        """What the envs were doing that diverged in the rollout that began at `trainer`; of the envs of all processes."""
        with jax.debug_key_reuse(False):  # on purpose: the same once more
            _, (rollout, _) = self.collect(env, trainer, np.float32(around))
            return evidence_of(env, trainer.envs, on_host(rollout.action))


@functools.lru_cache(maxsize=8)
def make_programs(plan: Plan) -> Programs:
    """Compilation itself happens at the first call of each."""
    everywhere, by_env = NamedSharding(plan.mesh, P()), NamedSharding(plan.mesh, P(ENVS))
    names = [field.name for field in dataclasses.fields(TrainerState)]
    shardings: dict[str, Any] = {name: by_env if name in ("envs", "episodes") else everywhere for name in names}
    trainer = TrainerState(**shardings)

    def of(function: Callable[..., Any]) -> Callable[..., Any]:
        return functools.partial(function, plan)

    return Programs(
        begin=jit_of_chains(of(iteration.begin), out_shardings=trainer),
        collect=jit_of_chains(of(iteration.collecting), out_shardings=(trainer, None)),
        learn=jax.jit(of(iteration.learning), out_shardings=(trainer, everywhere)),
        iterate=jit_of_chains(of(iteration.iterate), out_shardings=(trainer, everywhere)),
        store=jax.jit(of(iteration.storing), out_shardings=(everywhere, None, everywhere)),
        are_apart=jax.default_backend() == "cpu",
    )
