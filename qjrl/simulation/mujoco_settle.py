"""Settle with batches of C MuJoCo: a pool of simulations in threads, each refilled when it has come to rest."""

import dataclasses

import mujoco
import numpy as np
from mujoco import batch

from qjrl.cores import usable_cores
from qjrl.robot import build_mjcf
from qjrl.robot.verbs import Robot
from qjrl.simulation.settle_problem import RawSettled, SettleConfig, SettleProblem


def settle_mujoco(robot: Robot, problem: SettleProblem, config: SettleConfig, advance) -> RawSettled:
    """Run every row of `problem` to rest. A row's result does not depend on the pool, the threads or its neighbours."""
    num_rows = len(problem.joint_positions)
    pool = Pool(robot, config, min(config.batch_size, max(num_rows, 1)))
    result = _empty_result(problem)
    waiting = 0  # next row to start
    while waiting < num_rows or pool.is_active.any():
        free = np.flatnonzero(~pool.is_active)[: num_rows - waiting]
        if len(free):
            rows = np.arange(waiting, waiting + len(free))
            pool.start(free, rows, problem)
            waiting += len(free)
        finished = pool.step_until_any_finishes()
        pool.read(finished, result)
        advance(len(finished))
    return result


@dataclasses.dataclass
class Pool:
    """The simulations side by side and how far each has come."""

    robot: Robot
    config: SettleConfig
    size: int

    def __post_init__(self):
        self.model = mujoco.MjModel.from_xml_string(build_mjcf(self.robot, self.config.solver))
        self.batch = batch.Batch(self.model, self.size, self.config.num_threads or usable_cores())
        self.positions, self.velocities = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.force, self.warning = self.batch.bind("actuator_force"), self.batch.warning
        self.tip = self.batch.site("tip")
        self.tip_position, self.tip_rotation = self.tip.xpos, self.tip.xmat
        self.is_active = np.zeros(self.size, bool)
        self.row = np.zeros(self.size, int)
        self.steps = np.zeros(self.size, int)
        self.quiet_steps = np.zeros(self.size, int)

    def start(self, ids: np.ndarray, rows: np.ndarray, problem: SettleProblem) -> None:
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self.positions[ids] = problem.joint_positions[rows]
        self.batch.ctrl[ids] = problem.strand_commands[rows]
        self.row[ids], self.steps[ids], self.quiet_steps[ids] = rows, 0, 0
        self.is_active[ids] = True

    def step_until_any_finishes(self) -> np.ndarray:
        """Advance all active simulations; return those that rest, time out or diverge."""
        while True:
            failed = self._step()
            self.steps[self.is_active] += 1
            self.quiet_steps = np.where(self._speed() < self.config.rest_speed, self.quiet_steps + 1, 0)
            has_warned = self.warning[:, :, 1].any(axis=1)
            is_over = (self.quiet_steps >= self.config.hold_steps) | (self.steps >= self.config.max_steps)
            finished = np.flatnonzero(self.is_active & (is_over | has_warned | failed))
            if len(finished):
                self.is_active[finished] = False
                return finished

    def read(self, ids: np.ndarray, result: RawSettled) -> None:
        """Store the finished simulations' rows; one forward pass makes all fields describe the final state."""
        converged = (self.quiet_steps[ids] >= self.config.hold_steps) & ~self.warning[ids, :, 1].any(axis=1)
        self.batch.forward(ids)
        rows = self.row[ids]
        result.joint_positions[rows] = self.positions[ids]
        rotation = self.tip_rotation[ids].reshape(-1, 3, 3)
        result.pose[rows] = np.concatenate([self.tip_position[ids], rotation[:, :, 0], rotation[:, :, 1]], axis=1)
        result.strand_tension[rows] = np.maximum(-self.force[ids], 0.0)
        result.speed[rows] = self._speed()[ids]
        result.steps[rows] = self.steps[ids]
        result.converged[rows] = converged & np.isfinite(result.pose[rows]).all(axis=1)

    def _step(self) -> np.ndarray:
        """One step of the active simulations; which of them MuJoCo could not step."""
        failed = np.zeros(self.size, bool)
        try:
            self.batch.step(self.is_active)
        except batch.SimulationError as error:
            failed[list(error.ids)] = True
        return failed

    def _speed(self) -> np.ndarray:
        return np.abs(self.velocities).mean(axis=1)


def _empty_result(problem: SettleProblem) -> RawSettled:
    num_rows, num_positions = problem.joint_positions.shape
    return RawSettled(
        joint_positions=np.zeros((num_rows, num_positions)),
        pose=np.zeros((num_rows, 9)),
        strand_tension=np.zeros(problem.strand_commands.shape),
        speed=np.zeros(num_rows),
        steps=np.zeros(num_rows, int),
        converged=np.zeros(num_rows, bool),
    )
