"""Settle with batches of C MuJoCo: a pool of simulations in threads, each refilled when it has come to rest."""

import dataclasses

import mujoco
import numpy as np
from mujoco import batch

from qjrl.cores import usable_cores
from qjrl.robot.verbs import Robot
from qjrl.simulation.relaxation import relaxation
from qjrl.simulation.settle_problem import RawSettled, SettleConfig, SettleProblem, SettleStatus
from qjrl.simulation.settle_rule import LEAST_LOSS, approach, has_turned, mean_speed, next_loss, status, stiffness_seen


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
        self.relaxation = relaxation(self.robot, self.config)
        self.model = mujoco.MjModel.from_xml_string(self.relaxation.mjcf)
        self.batch = batch.Batch(self.model, self.size, self.config.num_threads or usable_cores())
        self.positions, self.velocities = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.force, self.warning = self.batch.bind("actuator_force"), self.batch.warning
        self.tip = self.batch.site("tip")
        self.tip_position, self.tip_rotation = self.tip.xpos, self.tip.xmat
        self.is_active = np.zeros(self.size, bool)
        self.row = np.zeros(self.size, int)
        self.steps = np.zeros(self.size, int)
        self.quiet_steps = np.zeros(self.size, int)
        self.turns = np.zeros(self.size, int)
        self.loss = np.zeros(self.size)
        self.rest_speed = np.zeros(self.size)
        self.velocities_before, self.velocities_then = np.zeros(self.velocities.shape), np.zeros(self.velocities.shape)
        self.positions_then, self.kicks_then = np.zeros(self.positions.shape), np.zeros(self.velocities.shape)

    def start(self, ids: np.ndarray, rows: np.ndarray, problem: SettleProblem) -> None:
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self.positions[ids] = problem.joint_positions[rows]
        self.batch.ctrl[ids] = problem.strand_commands[rows]
        self.row[ids], self.steps[ids], self.quiet_steps[ids], self.turns[ids] = rows, 0, 0, 0
        self.loss[ids] = self.relaxation.loss or 0.0
        self.rest_speed[ids] = self._rest_speed(0.5 * self.loss[ids])
        self.velocities_before[ids] = self.velocities_then[ids] = 0.0
        self.is_active[ids] = True

    def step_until_any_finishes(self) -> np.ndarray:
        """Advance all active simulations; return those that rest, time out or diverge."""
        while True:
            positions = self.positions.copy()
            failed = self._step()
            self.steps[self.is_active] += 1
            speed, kicks = self._damp()
            self.quiet_steps = np.where(speed < self.rest_speed, self.quiet_steps + 1, 0)
            self._look(positions, kicks)
            has_warned = self.warning[:, :, 1].any(axis=1)
            is_over = (self.quiet_steps >= self.config.hold_steps) | (self.steps >= self.config.max_steps)
            finished = np.flatnonzero(self.is_active & (is_over | has_warned | failed))
            if len(finished):
                self.is_active[finished] = False
                return finished

    def read(self, ids: np.ndarray, result: RawSettled) -> None:
        """Store the finished simulations' rows; one forward pass makes all fields describe the final state."""
        has_warned = self.warning[ids, :, 1].any(axis=1)
        self.batch.forward(ids)
        rows = self.row[ids]
        result.joint_positions[rows] = self.positions[ids]
        rotation = self.tip_rotation[ids].reshape(-1, 3, 3)
        result.pose[rows] = np.concatenate([self.tip_position[ids], rotation[:, :, 0], rotation[:, :, 1]], axis=1)
        result.strand_tension[rows] = np.maximum(-self.force[ids], 0.0)
        result.speed[rows] = mean_speed(np, self.velocities[ids])
        result.steps[rows] = self.steps[ids]
        is_finite = np.isfinite(result.pose[rows]).all(axis=1) & ~has_warned
        result.status[rows] = status(is_finite, self.quiet_steps[ids] >= self.config.hold_steps, self.turns[ids])

    def _step(self) -> np.ndarray:
        """One step of the active simulations; which of them MuJoCo could not step."""
        failed = np.zeros(self.size, bool)
        try:
            self.batch.step(self.is_active)
        except batch.SimulationError as error:
            failed[list(error.ids)] = True
        return failed

    def _damp(self) -> tuple[np.ndarray, np.ndarray]:
        """Take the loss; the speed that counts for rest (size,), and what the step changed the velocities by (size, nv)."""
        if self.relaxation.loss is None:
            return mean_speed(np, self.velocities), self.velocities
        kicks = self.velocities - self.velocities_before
        self.velocities *= 1.0 - self.loss[:, None]
        self.velocities_before[:] = self.velocities
        # where a row turns back it has no speed, but then forces move it
        speed = mean_speed(np, self.velocities) + 2.0 * mean_speed(np, kicks) / np.maximum(self.loss, LEAST_LOSS)
        return speed, kicks

    def _look(self, positions: np.ndarray, kicks: np.ndarray) -> None:
        """At the end of a window: has a row turned, and how stiff is what still moves?"""
        ids = np.flatnonzero(self.is_active & (self.steps % self.config.hold_steps == 0))
        if not len(ids):
            return
        is_late = self.steps[ids] > self.config.max_steps / 2
        self.turns[ids] += is_late & has_turned(np, self.velocities[ids], self.velocities_then[ids])
        if self.relaxation.loss is not None:
            seen = ids[self.steps[ids] > self.config.hold_steps]  # the first window has no kicks to compare with
            change = self.config.timestep * (kicks[seen] - self.kicks_then[seen])
            stiffness = stiffness_seen(np, positions[seen] - self.positions_then[seen], change)
            self.loss[seen] = next_loss(np, self.loss[seen], stiffness)
            self.rest_speed[seen] = self._rest_speed(approach(np, self.loss[seen], stiffness, self.config.max_steps))
        self.positions_then[ids], self.kicks_then[ids] = positions[ids], kicks[ids]
        self.velocities_then[ids] = self.velocities[ids]

    def _rest_speed(self, approaches: np.ndarray) -> np.ndarray | float:
        """At which what is left of the way is short enough [rad/s]."""
        if self.relaxation.loss is None:
            return self.config.rest_speed
        return self.config.rest_angle * approaches / self.config.timestep


def _empty_result(problem: SettleProblem) -> RawSettled:
    num_rows, num_positions = problem.joint_positions.shape
    return RawSettled(
        joint_positions=np.zeros((num_rows, num_positions)),
        pose=np.zeros((num_rows, 9)),
        strand_tension=np.zeros(problem.strand_commands.shape),
        speed=np.zeros(num_rows),
        steps=np.zeros(num_rows, int),
        status=np.full(num_rows, SettleStatus.DIVERGES),
    )
