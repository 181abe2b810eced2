"""Whether numbers that enter can be meant: held against what the robot can have, before any work.

A number far beyond what the arm can do is most often one in another unit. Where that would explain it, the error says so.
All doors that take cable lengths, positions or poses from outside ask here; what comes from the package itself is trusted.
"""

import numpy as np

from qjrl.config import ConfigError
from qjrl.robot.quaternion_arm.joint import height_of_cosine
from qjrl.robot.unit_hints import length_hint
from qjrl.robot.verbs import Robot, cable_strokes

# Of a path's positions: rolling joints carry the tip a little further than the straight arm's length.
REACH_MARGIN = 1.05
# Of targets, in lengths of the arm: those somewhat out of reach have a nearest answer.
FARTHEST_TARGET = 10.0
# Of commands that are settled, in strokes of the cable: answers beyond the joints' limits may be asked for.
LARGEST_COMMAND = 20.0
# Of a file of cable lengths, in strokes of the cable.
LARGEST_PLANNED = 1.25


def straight_length(robot: Robot) -> float:
    """From the base to the tip of the straight arm [m]."""
    joint = robot.config.joint
    height = height_of_cosine(joint.crossed_link_length, joint.pin_distance, joint.plate_to_pin, 1.0)
    return robot.num_joints * (float(height) + robot.config.link_length)


def check_cable_lengths(
    robot: Robot, lengths: np.ndarray, where: str = "cable_lengths", strokes: float = LARGEST_COMMAND
) -> None:
    """Refuse cable lengths (n, num_cables) [m], finite, that are many times what the cables can do.

    Args:
        where: what the message begins with.
        strokes: how many strokes of a cable are allowed.
    Raises:
        ConfigError: one line with row and cable.
    """
    allowed = strokes * np.asarray(cable_strokes(robot))
    share = np.abs(lengths) / allowed
    if share.size == 0 or share.max() <= 1.0:
        return
    row, cable = np.unravel_index(int(np.argmax(share)), share.shape)
    name = [number for pair in robot.config.cables.names for number in pair][int(cable)]
    raise ConfigError(
        f"{where}: row {row} (the first is 0), cable_{name}: got {lengths[row, cable]:.4g} m, allowed: up to "
        f"{allowed[cable]:.3g} m, {strokes:g} times the cable's stroke{length_hint(float(share.max()))}"
    )


def check_positions(
    robot: Robot, positions: np.ndarray, where: str, lengths: float = REACH_MARGIN, noun: str = "row"
) -> None:
    """Refuse positions (n, 3) [m], finite, too many of the straight arm's lengths away from the base.

    Args:
        where: what the message begins with.
        lengths: how many lengths of the arm are allowed.
    Raises:
        ConfigError: one line with the row that is farthest.
    """
    distance, length = np.linalg.norm(positions, axis=1), straight_length(robot)
    if distance.size == 0 or distance.max() <= lengths * length:
        return
    row = int(np.argmax(distance))
    times = "" if lengths == REACH_MARGIN else f"{lengths:g} times "
    raise ConfigError(
        f"{where}: {noun} {row} (the first is 0) is {distance[row]:.4g} m from the base, allowed: up to {times}"
        f"{length:.3g} m, the length of the straight arm{length_hint(float(distance[row]) / (lengths * length))}"
    )
