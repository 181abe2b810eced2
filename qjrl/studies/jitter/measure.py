"""Plays every case of the jitter study in both engines and evaluates the end of each."""

import dataclasses
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from qjrl.robot import bends_from_angles, cable_lengths, forward_kinematics
from qjrl.robot.verbs import Robot
from qjrl.simulation.row_by_row import row_by_row
from qjrl.studies.jitter.cable_models import Play, Recording, StrandLimits
from qjrl.studies.jitter.cases import (
    CONTROL_PERIOD,
    OWN_TOLERANCE,
    STEPS_PER_PERIOD,
    TIMESTEP,
    Case,
    JitterConfig,
    all_cases,
    deflected_cases,
)
from qjrl.studies.jitter.mujoco_recording import record_mujoco

ENGINES = tuple(OWN_TOLERANCE)
_C = ENGINES[0]
_SIDEWAYS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclasses.dataclass(frozen=True)
class Motion:
    """One case in one engine, one row a pose."""

    norm: np.ndarray
    """(poses, steps) Euclidean norm of the joint velocities, the quantity of the paper's Fig. 10 [rad/s]."""
    mean_speed: np.ndarray
    """(poses,) mean |joint velocity| over joints and window [rad/s]; NaN where it diverged."""
    peak_speed: np.ndarray
    """(poses,) the largest mean over the joints at one time step of the window [rad/s]."""
    averaged_speed: np.ndarray
    """(poses, averages) mean |moving average of the joint velocities| [rad/s]."""
    tip: np.ndarray
    """(poses, 3) at the end [m]."""


@dataclasses.dataclass(frozen=True)
class Commands:
    """What every case is told to do."""

    bends: np.ndarray
    """(poses, segments, 2)."""
    cable_lengths: np.ndarray
    """(poses, cables) [m] held in the end."""
    nominal_tip: np.ndarray
    """(poses, 3) [m] of the closed form."""


@dataclasses.dataclass(frozen=True)
class Findings:
    """All that was measured."""

    commands: Commands
    motions: dict[Case, dict[str, Motion]]
    """... by engine."""
    deflections: dict[Case, np.ndarray]
    """(poses, directions) how far the tip gives way to the force, in C MuJoCo [m]."""


def study(robot: Robot, config: JitterConfig, seed: int, advance: Callable[..., None]) -> Findings:
    """Play everything; `advance` is called with 1 after each play, of which there are `num_plays`."""
    commands = draw_commands(robot, config, seed)
    motions: dict[Case, dict[str, Motion]] = {case: {} for case in all_cases(config)}
    for group in groups(all_cases(config)):
        for engine, record in zip(ENGINES, (record_mujoco, _in_mjx(group, config.num_poses)), strict=True):
            recording = record(play_of(robot, config, group, commands, engine))
            for case, motion in zip(group, _motions(config, recording, len(group)), strict=True):
                motions[case][engine] = motion
            advance(1, note=f"{group[0].cables}, {engine}")
    deflections: dict[Case, np.ndarray] = {}
    for group in groups(deflected_cases(config)):
        deflections |= _deflections(robot, config, group, commands)
        advance(1, note=f"{group[0].cables}, deflection")
    return Findings(commands, motions, deflections)


def num_plays(config: JitterConfig) -> int:
    """Calls of `advance`."""
    return 2 * len(groups(all_cases(config))) + len(groups(deflected_cases(config)))


def groups(cases: Sequence[Case]) -> list[list[Case]]:
    """Cases that can be played side by side: the same cables, the same number of iterations."""
    found: dict[tuple, list[Case]] = {}
    for case in cases:
        found.setdefault((case.cables, case.iterations), []).append(case)
    return list(found.values())


def draw_commands(robot: Robot, config: JitterConfig, seed: int) -> Commands:
    """Bends uniform in angle up to a share of the limit, and in direction."""
    random = np.random.default_rng(seed)
    shape = (config.num_poses, robot.num_segments)
    angles = random.uniform(0.0, config.bend_share * float(robot.bend_limit), shape)
    directions = random.uniform(0.0, 2.0 * np.pi, shape)
    bends = np.asarray(bends_from_angles(jnp.asarray(directions), jnp.asarray(angles)))
    tips = row_by_row(forward_kinematics, robot, bends)[:, :3]
    return Commands(bends, row_by_row(cable_lengths, robot, bends), tips)


def play_of(
    robot: Robot, config: JitterConfig, cases: Sequence[Case], commands: Commands, engine: str = _C, repeat: int = 1
) -> Play:
    """All poses, each `repeat` times, of the first case, then of the second, ..."""
    periods = round((config.ramp_time + config.hold_time) / CONTROL_PERIOD)
    share = np.minimum(np.arange(1, periods + 1) * CONTROL_PERIOD / config.ramp_time, 1.0)
    rows = np.tile(np.repeat(commands.cable_lengths, repeat, axis=0), (len(cases), 1))
    each = lambda values: np.repeat(np.array(values, float), repeat * config.num_poses, axis=0)  # noqa: E731
    limits = StrandLimits(
        half_width=each([case.half_width for case in cases]),
        time_constant=each([case.rows.time_constant for case in cases]),
        impedance=each([case.rows.impedance for case in cases]),
    )
    tolerance = each([case.tolerance_in(engine) for case in cases])
    lengths = share[:, None, None] * rows
    return Play(robot, cases[0].cables, lengths, limits, tolerance, cases[0].iterations, TIMESTEP, STEPS_PER_PERIOD)


def moving_average(velocities: np.ndarray, width: int) -> np.ndarray:
    """Means over the last `width` time steps of (n, steps, nv), from the first full one: (n, steps - width + 1, nv)."""
    sums = np.cumsum(velocities.astype(np.float64), axis=1)
    padded = np.concatenate([np.zeros_like(sums[:, :1]), sums], axis=1)
    return (padded[:, width:] - padded[:, :-width]) / width


def _in_mjx(group: Sequence[Case], num_poses: int) -> Callable[[Play], Recording]:
    from qjrl.studies.jitter.mjx_recording import record_mjx

    is_balanced = np.repeat([case.is_balanced for case in group], num_poses)
    return lambda play: record_mjx(play, is_balanced)


def _motions(config: JitterConfig, recording: Recording, num_cases: int) -> list[Motion]:
    """Of each case, from the recording of all its group."""
    velocities = recording.joint_velocities
    window = velocities[:, -round(config.window / TIMESTEP) :]
    speeds = np.abs(window).mean(axis=2)
    averaged = [
        np.abs(moving_average(velocities, width)[:, -window.shape[1] :]).mean(axis=(1, 2)) for width in config.averages
    ]
    whole = Motion(
        norm=np.linalg.norm(velocities, axis=2),
        mean_speed=speeds.mean(axis=1),
        peak_speed=speeds.max(axis=1),
        averaged_speed=np.stack(averaged, axis=1) if averaged else np.zeros((len(velocities), 0)),
        tip=recording.tip,
    )
    parts = {field.name: np.split(getattr(whole, field.name), num_cases) for field in dataclasses.fields(Motion)}
    return [Motion(**{name: values[index] for name, values in parts.items()}) for index in range(num_cases)]


def _deflections(
    robot: Robot, config: JitterConfig, group: Sequence[Case], commands: Commands
) -> dict[Case, np.ndarray]:
    """Distance between where the tip ends with the force and without it."""
    forces = config.force * np.concatenate([np.zeros((1, 3)), _SIDEWAYS])
    play = play_of(robot, config, group, commands, repeat=len(forces))
    recording = record_mujoco(play, np.tile(forces, (len(group) * config.num_poses, 1)))
    tips = recording.tip.reshape(len(group), config.num_poses, len(forces), 3)
    return dict(zip(group, np.linalg.norm(tips[:, :, 1:] - tips[:, :, :1], axis=-1), strict=True))
