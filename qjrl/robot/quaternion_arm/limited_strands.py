"""Strands as tendon limits instead of servos: the cables of paper 000, section 5.4.1, as we read it.

A strand's length is held within +- half a range of what is commanded, by MuJoCo's rows for tendon limits. It pushes as well
as it pulls, has no stiffness of its own, and a command moves the range: `tendon_range`, a field of the model.
"""

from xml.etree import ElementTree

from jaxtyping import Array, Float

from qjrl.robot.quaternion_arm.arm import QuaternionArm
from qjrl.robot.quaternion_arm.cables import bends_from_cables, strand_lengths

# Until it is commanded a strand is free [m].
FREE_RANGE = "0 1000"


def limit_strands(mjcf: str) -> str:
    """The MJCF of an arm whose strands, its actuated tendons, are limited instead; there are no actuators any more."""
    root = ElementTree.fromstring(mjcf)
    for actuator in root.findall("actuator"):
        for servo in actuator:
            strand = root.find(f"tendon/spatial[@name='{servo.get('tendon')}']")
            assert strand is not None, f"servo {servo.get('name')} pulls no spatial tendon"
            strand.set("range", FREE_RANGE)
        root.remove(actuator)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def held_strand_lengths(arm: QuaternionArm, lengths: Float[Array, "cables"]) -> Float[Array, "strands"]:
    """Centres of the strands' ranges [m] for cable lengths [m]: what the strands measure at the nominal bends.

    The common part of a rolling joint's strands is in it, so that all ranges can be kept at once however narrow they are.
    """
    return strand_lengths(arm, bends_from_cables(arm, lengths))
