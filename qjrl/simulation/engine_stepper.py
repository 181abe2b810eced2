"""An engine of JAX behind the contract of the host, `stepping.Stepper`: for evaluation and for playing trajectories."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from qjrl.progress import compiling
from qjrl.robot.plant import PhysicalParameters, PlantState
from qjrl.simulation.engine import Engine
from qjrl.xla_options import jit_of_chains


class EngineStepper:
    """`num_sims` simulations, cut over this process's devices where they divide evenly; nothing but float32 inside."""

    def __init__(self, engine: Engine, num_sims: int):
        self.num_sims, self.timestep, self._engine = num_sims, engine.timestep, engine
        devices = jax.local_devices()
        devices = devices if num_sims % len(devices) == 0 else devices[:1]
        mesh = Mesh(np.array(devices), ("envs",))
        self._rows, self._everywhere = NamedSharding(mesh, P("envs")), NamedSharding(mesh, P())
        self._parameters = PhysicalParameters.nominal(engine.robot, num_sims)
        with jax.enable_x64(False), compiling(f"{num_sims} arms"):
            self._engine = jax.device_put(engine, self._everywhere)
            self._state = _home(self._engine, self._placed(self._parameters))
        self._seen: PlantState | None = None

    def reset(
        self, ids: np.ndarray, joint_positions: np.ndarray, strand_commands: np.ndarray, parameters: PhysicalParameters
    ) -> None:
        """Put simulations `ids` at rest at joint positions (len(ids), nq), holding commands, with new parameters."""
        self._parameters.assign(ids, parameters.arrays())
        chosen = np.zeros(self.num_sims, bool)
        chosen[ids] = True
        positions = np.zeros((self.num_sims, np.shape(joint_positions)[-1]))
        commands = np.zeros((self.num_sims, np.shape(strand_commands)[-1]))
        positions[ids], commands[ids] = joint_positions, strand_commands
        with jax.enable_x64(False):
            placed = self._placed((chosen, positions, commands, self._parameters))
            self._state = _restart(self._engine, self._state, *placed)
        self._seen = None

    def step(self, strand_commands: np.ndarray, num_steps: int) -> None:
        """Hold rest lengths (n, strands) [m] for `num_steps` time steps; a simulation that diverges stays where it was."""
        with jax.enable_x64(False):
            commands = self._placed(np.broadcast_to(strand_commands, (self.num_sims, np.shape(strand_commands)[-1])))
            self._state = _advance(self._engine, self._state, commands, np.int32(num_steps))
        self._seen = None

    def wait(self) -> None:
        """Returns when all steps are made."""
        jax.block_until_ready(self._state)

    def read(self) -> PlantState:
        """The state of all simulations now, float64 as from C MuJoCo."""
        if self._seen is None:
            with jax.enable_x64(False):
                seen = _read(self._engine, self._state)
            self._seen = PlantState(**{name: _as_double(values) for name, values in vars(seen).items()})
        return self._seen

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that a bitwise continuation needs, a row for each simulation."""
        leaves = {f"state/{index}": np.array(leaf) for index, leaf in enumerate(jax.tree.leaves(self._state))}
        return leaves | self._parameters.arrays()

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go back to what `get_state` returned."""
        self._parameters.assign(np.arange(self.num_sims), state)
        leaves, structure = jax.tree.flatten(self._state)
        with jax.enable_x64(False):
            self._state = self._placed(structure.unflatten([state[f"state/{index}"] for index in range(len(leaves))]))
        self._seen = None

    def _placed(self, tree: Any) -> Any:
        """Host arrays as those of the devices, cut by row; float64 becomes float32."""
        return jax.tree.map(lambda leaf: jax.device_put(_as_single(np.asarray(leaf)), self._rows), tree)


def _as_single(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32) if values.dtype == np.float64 else values


def _as_double(values: jax.Array) -> np.ndarray:
    found = np.asarray(values)
    return found.astype(np.float64) if found.dtype == np.float32 else found


@jit_of_chains
def _home(engine: Any, parameters: PhysicalParameters) -> Any:
    return engine.home(parameters)


@jit_of_chains
def _restart(engine: Any, state: Any, chosen: jax.Array, positions: jax.Array, commands: jax.Array, parameters: Any):
    fresh = engine.placed(engine.home(parameters), positions, commands)
    return jax.tree.map(lambda new, old: jnp.where(chosen.reshape(-1, *[1] * (new.ndim - 1)), new, old), fresh, state)


@jit_of_chains
def _advance(engine: Any, state: Any, commands: jax.Array, num_steps: jax.Array) -> Any:
    return engine.advance(state, commands, num_steps)


@jit_of_chains
def _read(engine: Any, state: Any) -> PlantState:
    return engine.read(state)
