"""What the envs were doing that diverged: the rollout played once more, step by step, from where it began."""

import jax
import numpy as np

from qjrl.learning.ppo.environment import Env, State
from qjrl.learning.ppo.mesh import on_host
from qjrl.xla_options import jit_of_chains

# Of the steps in which envs diverge the first ones show the cause; the others are only counted.
_MOST_STEPS = 20


def evidence_of(env: Env, before: State, actions: np.ndarray) -> dict[str, np.ndarray]:
    """States, observations and actions of the envs in the step before they diverged.

    Args:
        before: where the rollout began.
        actions: (steps, envs, action size).
    Returns:
        `env` (rows,), `rollout_step` (rows,), `action`, and PATH -> (rows, ...) of the state; empty if nothing diverges again.
    """
    state, found = before, []
    for number, action in enumerate(actions):
        following = _step(env, state, action)
        ids = np.flatnonzero(~on_host(following.valid))
        if len(ids) and len(found) < _MOST_STEPS:
            found.append(
                _rows(state, ids) | {"env": ids, "rollout_step": np.full(len(ids), number), "action": action[ids]}
            )
        state = following
    return {name: np.concatenate([rows[name] for rows in found]) for name in (found[0] if found else ())}


def _rows(state: State, ids: np.ndarray) -> dict[str, np.ndarray]:
    known = on_host({"inner": state.inner, "seen": dict(state.observation)})
    return {
        jax.tree_util.keystr(path, simple=True, separator="/"): leaf[ids]
        for path, leaf in jax.tree_util.tree_leaves_with_path(known)
    }


@jit_of_chains
def _step(env: Env, state: State, actions: jax.Array) -> State:
    return env.step(state, actions)
