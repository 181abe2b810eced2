"""The settled pose is a matter of physics: least potential energy, whatever the numerical settings."""

import dataclasses

import mujoco
import numpy as np
import pytest
from arms import MADE_UP, altered, arm_named, made_up_mapping, over_rows, random_bends
from mujoco import batch
from statics import equilibria

from qjrl.robot import (
    build_mjcf,
    cable_lengths,
    forward_kinematics,
    joint_positions,
    load_robot,
    robot_from_mapping,
    strand_commands,
    strand_lengths,
)
from qjrl.robot.solver_options import SolverOptions
from qjrl.simulation import SettleConfig, settle
from qjrl.simulation.mujoco_settle import settle_mujoco
from qjrl.simulation.settling import SettleProblem


@dataclasses.dataclass(frozen=True)
class WithOptions(SettleConfig):
    """Settling with every numerical setting of the physics open."""

    options: SolverOptions = SolverOptions()

    @property
    def solver(self) -> SolverOptions:
        return self.options


def distance_mm(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    return 1e3 * np.linalg.norm(poses[:, :3] - others[:, :3], axis=1)


def weightless(name: str, **changes):
    """An arm without gravity and joint stiffness."""
    mapping = made_up_mapping(name) if name in MADE_UP else altered(name)
    mapping["mechanics"] |= {"gravity": [0.0, 0.0, 0.0], "joint_stiffness": 0.0}
    mapping["strands"] |= changes
    return robot_from_mapping(mapping)


@pytest.mark.parametrize("name", ["qj_2222", "qj_2222_spherical", "qj_huang_4332_480", "rolling_312"])
def test_the_arm_rests_where_the_potential_energy_is_least(name):
    arm = arm_named(name)
    lengths = over_rows(cable_lengths, arm, random_bends(arm, 16, seed=3, share=0.9))
    result = settle(arm, lengths)
    tips, tension = equilibria(arm, lengths)
    assert result.converged.all()
    assert distance_mm(result.pose, tips).max() < 0.01
    assert np.abs(result.strand_tension - tension).max() < 0.05


BASE = SettleConfig(damping_scale=10.0).solver
CHANGES = {
    "armature /3": dataclasses.replace(BASE, armature_scale=BASE.armature_scale / 3),
    "armature x2": dataclasses.replace(BASE, armature_scale=BASE.armature_scale * 2),
    "time step /2": dataclasses.replace(BASE, timestep=0.002),
    "solref x2": dataclasses.replace(BASE, equality_time_constant=2 * BASE.equality_time_constant),
    "damping /2": dataclasses.replace(BASE, damping_scale=5.0),
    "iterations x2": dataclasses.replace(BASE, solver_iterations=40),
}


@pytest.mark.parametrize("name", ["qj_2222", "rolling_312", "spherical_312"])
def test_the_settled_pose_depends_on_physical_parameters_only(name):
    arm = arm_named(name)
    lengths = over_rows(cable_lengths, arm, random_bends(arm, 12, seed=4))
    reference = settle(arm, lengths)
    assert reference.equality_error.max() < 1e-4
    for change, options in CHANGES.items():
        config = WithOptions(timestep=options.timestep, damping_scale=options.damping_scale, options=options)
        result = settle(arm, lengths, config=config)
        assert result.converged.all(), change
        assert result.equality_error.max() < 1e-4, change
        assert distance_mm(result.pose, reference.pose).max() < 0.02, change


@pytest.mark.parametrize("name", ["qj_2222_spherical", "spherical_312"])
def test_without_weight_and_joint_springs_a_spherical_arm_takes_its_nominal_pose(name):
    arm = weightless(name)
    bends = random_bends(arm, 12, seed=6)
    lengths = over_rows(cable_lengths, arm, bends)
    start = over_rows(joint_positions, arm, 0.8 * bends)
    raw = settle_mujoco(
        arm, SettleProblem(start, over_rows(strand_commands, arm, lengths)), SettleConfig(), no_progress
    )
    assert raw.converged.all()
    assert distance_mm(raw.pose, over_rows(forward_kinematics, arm, bends)).max() < 0.01


def test_without_weight_and_joint_springs_a_rolling_arm_takes_the_pose_of_its_strands():
    """Each of the 16 strands at its own closed-form length and no pretension: the nominal pose is the one that fits all."""
    arm = weightless("qj_2222", pretension=0.0)
    bends = random_bends(arm, 12, seed=6)
    start = over_rows(joint_positions, arm, 0.8 * bends)
    raw = settle_mujoco(arm, SettleProblem(start, over_rows(strand_lengths, arm, bends)), SettleConfig(), no_progress)
    assert raw.converged.all()
    assert distance_mm(raw.pose, over_rows(forward_kinematics, arm, bends)).max() < 0.01


def test_pretension_pulls_a_bent_rolling_arm_off_its_nominal_pose():
    """All strands pull a joint towards less height: uniform pretension is no equilibrium where H depends on theta.

    So eight motors and pretension cannot hold the default arm at its nominal pose, and the energy says by how much.
    """
    arm = weightless("qj_2222")
    bends = random_bends(arm, 12, seed=6)
    lengths = over_rows(cable_lengths, arm, bends)
    result = settle(arm, lengths)
    assert distance_mm(result.pose, over_rows(forward_kinematics, arm, bends)).max() > 1.0
    assert distance_mm(result.pose, equilibria(arm, lengths)[0]).max() < 0.01


def no_progress(count: int) -> None:
    del count


@dataclasses.dataclass
class Ramps:
    """Commands beyond the limit, reached at motor speed with the robot's own damping: what happened on the way."""

    largest_angle: float = 0.0
    largest_angle_at_rest: float = 0.0
    largest_push: float = -np.inf
    final_speed: float = 0.0


def bend_angles(arm, link_rotations: np.ndarray) -> np.ndarray:
    """Bend angles (n, joints) [rad] between the plate normals, from the links' rotations (n, joints, 3, 3)."""
    normals = np.concatenate(
        [np.broadcast_to([0.0, 0.0, 1.0], (len(link_rotations), 1, 3)), link_rotations[..., 2]], axis=1
    )
    return np.arccos(np.clip((normals[:, 1:] * normals[:, :-1]).sum(axis=2), -1.0, 1.0))


def equal_bends(arm, directions: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Bends (n, segments, 2), every segment alike."""
    one = np.sin(angles / 2.0)[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=1)
    return np.repeat(one[:, None], arm.num_segments, axis=1)


def ramp(arm, directions_deg, overshoots) -> Ramps:
    model = mujoco.MjModel.from_xml_string(build_mjcf(arm))
    directions = np.radians(np.repeat(directions_deg, len(overshoots)))
    angles = float(arm.bend_limit) * np.tile(overshoots, len(directions_deg))
    bends = equal_bends(arm, directions, angles)
    lengths = over_rows(cable_lengths, arm, bends)
    simulations = batch.Batch(model, len(bends))
    rotations, force, velocity = simulations.bind("xmat"), simulations.bind("actuator_force"), simulations.bind("qvel")
    home = over_rows(strand_commands, arm, np.zeros((1, arm.num_cables)))
    seen, step = Ramps(), float(arm.motor_speed) * model.opt.timestep
    peak = np.abs(lengths).max(axis=1, keepdims=True)
    num_steps = int(peak.max() / step) + 150
    for index in range(num_steps):
        paid_out = lengths * np.minimum(1.0, index * step / peak)
        simulations.ctrl[:] = home + np.stack([paid_out, -paid_out], axis=2).reshape(len(lengths), -1)
        simulations.step()
        angle = np.degrees(bend_angles(arm, rotations.reshape(len(bends), -1, 3, 3)[:, 2::2]).max())
        seen.largest_angle = max(seen.largest_angle, angle)
        seen.largest_push = max(seen.largest_push, force.max())
        if index >= num_steps - 50:
            seen.largest_angle_at_rest = max(seen.largest_angle_at_rest, angle)
    seen.final_speed = np.abs(velocity).mean(axis=1).max()
    return seen


@pytest.mark.parametrize("name", ["qj_2222", "qj_2222_spherical", "rolling_312"])
def test_the_stop_holds_in_every_direction_and_strands_never_push(name):
    """Commands of 1.2 to 1.6 times the limit at motor speed: strands reach their strength, theta stays at the stop."""
    arm = arm_named(name)
    stop = arm.config.joint.bend_limit_deg + arm.config.joint.stop_margin_deg
    seen = ramp(arm, directions_deg=[0.0, 45.0, 100.0], overshoots=[1.2, 1.6])
    assert seen.largest_angle > stop - 0.1
    assert seen.largest_angle < stop + 1.0
    assert seen.largest_angle_at_rest < stop + 0.5
    assert seen.final_speed < 0.05
    assert seen.largest_push <= 0.0


@pytest.mark.parametrize("name", ["qj_2222", "qj_huang_4332_480", "spherical_312"])
def test_settling_far_beyond_the_reach_rests_at_the_stop(name):
    arm = arm_named(name)
    beyond = np.full(3, np.radians(1.5 * arm.config.joint.bend_limit_deg))
    bends = equal_bends(arm, np.radians([0.0, 45.0, 200.0]), beyond)
    result = settle(arm, over_rows(cable_lengths, arm, bends))
    assert result.converged.all()
    angles = np.degrees(2.0 * np.arcsin(np.linalg.norm(result.bends, axis=2)))
    stop = arm.config.joint.bend_limit_deg + arm.config.joint.stop_margin_deg
    assert stop - 0.1 < angles.max() < stop + 0.5
    assert (result.strand_tension.max(axis=1) <= arm.config.strands.strength).all()


def test_a_hanging_arm_is_stretched_and_a_payload_bends_it_down():
    hanging = robot_from_mapping(altered("qj_22", mechanics__gravity=[0.0, 0.0, 9.81]))
    upright, sideways = load_robot("qj_22"), robot_from_mapping(altered("qj_22", mechanics__gravity=[9.81, 0, 0]))
    loaded = robot_from_mapping(altered("qj_22", mechanics__gravity=[9.81, 0, 0], mechanics__payload=0.2))
    home = np.zeros((1, 4))
    down, up = settle(hanging, home), settle(upright, home)
    np.testing.assert_allclose(down.pose[0, :2], 0.0, atol=1e-6)
    np.testing.assert_allclose(up.pose[0, :2], 0.0, atol=1e-6)
    sag = settle(sideways, home).pose[0, 0]
    assert 0.0 < sag < settle(loaded, home).pose[0, 0]
