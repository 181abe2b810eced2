"""Step many arms in time, each with its own physical parameters: batches of C MuJoCo in threads."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from mujoco import batch

from qjrl.cores import usable_cores
from qjrl.robot import build_mjcf
from qjrl.robot.plant import LARGEST_VALUE, PhysicalParameters, PlantState, tilted
from qjrl.robot.solver_options import SolverOptions
from qjrl.robot.verbs import Robot
from qjrl.simulation.payload import tip_body


@runtime_checkable
class Stepper(Protocol):
    """Many simulations of one robot, stepped together: on the host: C MuJoCo, or an engine of JAX."""

    num_sims: int
    timestep: float

    def reset(
        self, ids: np.ndarray, joint_positions: np.ndarray, strand_commands: np.ndarray, parameters: PhysicalParameters
    ) -> None:
        """Put simulations `ids` at rest at joint positions, holding commands, with new parameters."""
        ...

    def step(self, strand_commands: np.ndarray, num_steps: int) -> None:
        """Hold rest lengths (n, strands) [m] for `num_steps` time steps."""
        ...

    def read(self) -> PlantState:
        """The state of all simulations now."""
        ...

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that a bitwise continuation needs, a row for each simulation."""
        ...

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go back to what `get_state` returned."""
        ...


class MujocoStepper:
    """`num_sims` simulations of one robot on the CPU's cores, stepped together."""

    def __init__(self, robot: Robot, num_sims: int, timestep: float = 0.004, num_threads: int = 0):
        self.model = mujoco.MjModel.from_xml_string(build_mjcf(robot, SolverOptions(timestep=timestep)))
        self.num_sims, self.timestep, self.num_strands = num_sims, timestep, robot.num_strands
        self._batch = batch.Batch(self.model, num_sims, num_threads or usable_cores())
        self._positions, self._velocities = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._lengths, self._rates = self._batch.bind("ten_length"), self._batch.bind("ten_velocity")
        self._force, self._warning = self._batch.bind("actuator_force"), self._batch.warning
        tip = self._batch.site("tip")
        self._tip_position, self._tip_rotation = tip.xpos, tip.xmat
        self._has_failed = np.zeros(num_sims, bool)
        self._robot, self._is_loaded = robot, False
        self._parameters = PhysicalParameters.nominal(robot, num_sims)
        self._set_parameters(np.arange(num_sims))

    def reset(
        self, ids: np.ndarray, joint_positions: np.ndarray, strand_commands: np.ndarray, parameters: PhysicalParameters
    ) -> None:
        """Put simulations `ids` at rest at joint positions (len(ids), nq), holding commands, with new parameters."""
        self._parameters.assign(ids, parameters.arrays())
        self._set_parameters(ids)
        self._batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._positions[ids], self._velocities[ids] = joint_positions, 0.0
        self._batch.ctrl[ids] = strand_commands
        self._has_failed[ids] = False
        self._batch.forward(ids)

    def step(self, strand_commands: np.ndarray, num_steps: int) -> None:
        """Hold rest lengths (n, strands) [m] for `num_steps` time steps; a simulation that fails stays where it was."""
        self._batch.ctrl[:] = strand_commands
        try:
            self._batch.step(nstep=num_steps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        except batch.SimulationError as error:
            self._has_failed[list(error.ids)] = True

    def read(self) -> PlantState:
        """The state of all simulations now."""
        rotation = self._tip_rotation.reshape(-1, 3, 3)
        pose = np.concatenate([self._tip_position, rotation[:, :, 0], rotation[:, :, 1]], axis=1)
        has_warned = self._warning[:, :, 1].any(axis=1)
        is_plausible = (np.abs(self._velocities) < LARGEST_VALUE).all(axis=1)  # False for NaN
        is_sound = ~(has_warned | self._has_failed) & is_plausible & np.isfinite(pose).all(axis=1)
        strands = slice(0, self.num_strands)
        return PlantState(
            self._positions,
            self._velocities,
            self._lengths[:, strands],
            self._rates[:, strands],
            0.0 - self._force,
            pose,
            is_sound,
        )

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that a bitwise continuation needs."""
        own = {"state": self._batch.state.copy(), "has_failed": self._has_failed.copy()}
        return own | self._parameters.arrays()

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go back to what `get_state` returned."""
        everyone = np.arange(self.num_sims)
        self._parameters.assign(everyone, state)
        self._set_parameters(everyone)
        self._batch.state[:] = state["state"]
        self._has_failed[:] = state["has_failed"]

    def _set_parameters(self, ids: np.ndarray) -> None:
        model, ours, strands = self.model, self._parameters, slice(0, self.num_strands)
        field = self._batch.expand
        field("tendon_damping")[ids, strands] = model.tendon_damping[strands] * ours.strand_damping_scale[ids, None]
        field("tendon_frictionloss")[ids, strands] = ours.strand_friction[ids, None]
        field("dof_armature")[ids] = model.dof_armature * ours.armature_scale[ids, None]
        field("actuator_gainprm")[ids] = model.actuator_gainprm * ours.strand_gain[ids, :, None]
        field("actuator_biasprm")[ids] = model.actuator_biasprm * ours.strand_gain[ids, :, None]
        field("opt.gravity")[ids] = tilted(model.opt.gravity, ours.tilt[ids])
        self._set_payload(ids)
        self._batch.set_const(ids)

    def _set_payload(self, ids: np.ndarray) -> None:
        """The fields of the last body, which belong to the simulations only once one has a payload of its own."""
        payload = self._parameters.payload[ids]
        self._is_loaded |= bool(np.any(payload != self._robot.payload))
        if self._is_loaded:
            tip, body = tip_body(self._robot, self.model, payload), self.model.site_bodyid[self.model.site("tip").id]
            self._batch.expand("body_mass")[ids, body] = tip.mass
            self._batch.expand("body_ipos")[ids, body] = tip.centre
            self._batch.expand("body_inertia")[ids, body] = tip.inertia
