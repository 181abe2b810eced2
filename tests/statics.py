"""Statics in numpy, without MuJoCo and without the package's kinematics: where an arm's potential energy is least."""

import numpy as np

from qjrl.robot.verbs import Robot


def equilibria(arm: Robot, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tip positions (n, 3) [m] and strand tensions (n, strands) [N] of least energy at cable lengths (n, cables) [m].

    Newton from the nominal bends, with slopes and curvatures by differences of the energy.
    """
    commands = rest_lengths(arm, lengths)
    size = 2 * arm.num_segments
    flat = np.linalg.solve(linear_part(arm), lengths.T).T
    pairs = np.eye(size)[:, None, :] + np.stack([np.eye(size), -np.eye(size)])[:, None]  # (2, i, j, size): e_i +- e_j
    change = np.ones_like(flat)
    for _ in range(20):
        forward, backward = energies(arm, flat, commands, 1e-5 * np.stack([np.eye(size), -np.eye(size)]))
        slope = (forward - backward) / 2e-5
        same, crossed = energies(arm, flat, commands, 1e-4 * pairs) + energies(arm, flat, commands, -1e-4 * pairs)
        change = np.linalg.solve((same - crossed) / 4e-8, slope[..., None])[..., 0]
        flat = flat - change * np.minimum(1.0, 0.1 / np.linalg.norm(change, axis=1, keepdims=True))
        if np.abs(change).max() < 1e-9:
            break
    assert np.abs(change).max() < 1e-7, "the energy's minimum was not found"
    bends = flat.reshape(len(flat), -1, 2)
    return tips_and_weight(arm, bends)[0], tension(arm, bends, commands)


def energies(arm: Robot, flat: np.ndarray, commands: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """The energy at `flat` + each of the steps (2, ..., size): (2, n, ...)."""
    moved = flat.reshape(len(flat), *[1] * (steps.ndim - 1), -1) + steps
    repeated = np.repeat(commands, steps[..., 0].size, axis=0)
    rows = energy(arm, moved.reshape(len(repeated), -1), repeated).reshape(moved.shape[:-1])
    return np.moveaxis(rows, 1, 0)


def energy(arm: Robot, flat: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Weight, joint springs and strands [J], (n,). Strands pull only; joints and links are rigid.

    The joint springs are the MJCF's: 2K on each of the four half-angle hinges, 1/2 K theta^2 within 3 % up to 70 degrees.
    """
    bends = flat.reshape(len(flat), -1, 2)
    x, y = np.arctan2(bends[..., 1], np.sqrt(1.0 - (bends**2).sum(axis=2))), np.arcsin(bends[..., 0])
    springs = 2.0 * arm.config.mechanics.joint_stiffness * ((x**2 + y**2) * arm.joints_per_segment).sum(axis=1)
    strands = (tension(arm, bends, commands) ** 2).sum(axis=1) / (2.0 * float(arm.strand_stiffness))
    return tips_and_weight(arm, bends)[1] + springs + strands


def tips_and_weight(arm: Robot, bends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tip positions (n, 3) and the potential energy of gravity (n,), along the chain of half-turns."""
    mechanics = arm.config.mechanics
    position, rotation = np.zeros((len(bends), 3)), np.broadcast_to(np.eye(3), (len(bends), 3, 3))
    moment = np.zeros((len(bends), 3))  # sum of mass times position
    for segment in np.repeat(np.arange(arm.num_segments), arm.joints_per_segment):
        a = bends[:, segment]
        n = np.concatenate([a, np.sqrt(1.0 - (a**2).sum(axis=1, keepdims=True))], axis=1)
        chord = np.einsum("nij,nj->ni", rotation, n)
        moment += mechanics.joint_mass * (position + 0.5 * heights(arm, np.ones(1)) * chord)
        position = position + heights(arm, n[:, 2])[:, None] * chord
        rotation = rotation @ (2.0 * n[:, :, None] * n[:, None, :] - np.eye(3)) * np.array([-1.0, -1.0, 1.0])
        moment += mechanics.link_mass * (position + 0.5 * arm.config.link_length * rotation[:, :, 2])
        position = position + arm.config.link_length * rotation[:, :, 2]
    moment += mechanics.payload * position
    return position, -moment @ np.array(mechanics.gravity)


def heights(arm: Robot, cosine: np.ndarray) -> np.ndarray:
    """H from cos(theta/2) [m]."""
    joint = arm.config.joint
    return (
        np.sqrt(joint.crossed_link_length**2 - (joint.pin_distance * cosine) ** 2) + 2.0 * joint.plate_to_pin * cosine
    )


def linear_part(arm: Robot) -> np.ndarray:
    """(cables, bends): - D m_j (cos b, sin b) where the cable crosses segment j."""
    angles = np.radians([angle for pair in arm.config.cables.hole_angles_deg for angle in pair])
    crosses = np.arange(arm.num_cables)[:, None] // 2 >= np.arange(arm.num_segments)
    weights = -arm.config.cables.hole_circle_diameter * np.array(arm.joints_per_segment) * crosses
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return (weights[:, :, None] * directions[:, None, :]).reshape(arm.num_cables, -1)


def strands(arm: Robot, bends: np.ndarray) -> np.ndarray:
    """Strand lengths (n, strands) inside the joints they cross [m]."""
    joints = heights(arm, np.sqrt(1.0 - (bends**2).sum(axis=2))) * arm.joints_per_segment
    common = np.repeat(np.cumsum(joints, axis=1), 2, axis=1)
    differs = bends.reshape(len(bends), -1) @ linear_part(arm).T
    return np.stack([common + differs, common - differs], axis=2).reshape(len(bends), -1)


def rest_lengths(arm: Robot, lengths: np.ndarray) -> np.ndarray:
    """Rest lengths (n, strands) that the motors give at cable lengths (n, cables) [m]."""
    home = strands(arm, np.zeros((1, arm.num_segments, 2)))
    signed = np.stack([lengths, -lengths], axis=2).reshape(len(lengths), -1)
    return home + signed - arm.config.strands.pretension / float(arm.strand_stiffness)


def tension(arm: Robot, bends: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Of every strand (n, strands) [N]."""
    return float(arm.strand_stiffness) * np.maximum(strands(arm, bends) - commands, 0.0)
