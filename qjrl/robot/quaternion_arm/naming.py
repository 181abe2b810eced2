"""Names of the MJCF's elements."""

from qjrl.robot.quaternion_arm.arm import QuaternionArm


def joint_labels(arm: QuaternionArm) -> list[str]:
    """Labels "segment_joint" from the base, both counted from 1; the name of every joint's element ends in one."""
    return [f"{k + 1}_{j + 1}" for k, count in enumerate(arm.joints_per_segment) for j in range(count)]


def segment_of(label: str) -> int:
    """Index of the segment, counted from 0, that a joint belongs to."""
    return int(label.split("_")[0]) - 1


def first_of_segment(label: str) -> str:
    """Label of the first joint of the same segment."""
    return label.split("_")[0] + "_1"


def leader(label: str, size: int) -> str:
    """Label of the first joint of the group of `size` neighbours in its segment that a joint belongs to."""
    segment, joint = label.split("_")
    return f"{segment}_{(int(joint) - 1) // size * size + 1}"


def cable_numbers(arm: QuaternionArm) -> tuple[int, ...]:
    """The number that each cable goes by on the machine (num_cables,)."""
    return tuple(number for pair in arm.cable_numbers for number in pair)


def strand_name(arm: QuaternionArm, strand: int) -> str:
    """ "strand_NUMBER_a" at the cable's hole angle, "strand_NUMBER_b" opposite to it."""
    return f"strand_{cable_numbers(arm)[strand // 2]}_{'ab'[strand % 2]}"
