"""The residual controller as two functions to export: one that begins with a target, one for every control period.

State in, state out, as flat named arrays: what a target fixes is an input alone, what changes comes back as `next_NAME`.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax

from qjrl.deployment.functions import DeployedFunction, Outputs, Port, Precision
from qjrl.robot.kinds import configuration_shape, verb
from qjrl.robot.verbs import Robot

_ACTION = "a residual of the tip: shift, then rotation vector times 0.1 m; or one of every cable"
_FIXED = {
    "target": ("m, -", "pose to reach; order: pose_names"),
    "base_lengths": ("m", "the base controller's answer to the target, relative to home; order: cables"),
    "correction": ("-", "cable lengths for each metre that the tip lacks, around the base command"),
    "expected": ("rad", "deviation from the command with which the arm is believed to rest before it is read"),
    "covariance": ("-", "of that, in standard deviations of one reading"),
}
# What of it is computed at the beginning.
_ANSWERED = ("correction", "expected", "covariance")
_CARRIED = {
    "command": ("m", "cable lengths that the motors hold, relative to home; order: cables"),
    "trend": ("m", "what feedback and policy add to the base command, smoothed"),
    "swing": ("m", "what the dither swings by"),
    "integral": ("m", "what integral feedback adds"),
    "residual": ("m", f"what the policy adds; {_ACTION}"),
    "actions": ("-", f"the policy's last actions, newest first; each {_ACTION}"),
    "memory": ("rad", "means of the readings' deviation from the command, segment by segment"),
    "step": ("-", "control periods since the target was set"),
}
READING = "reading"
_READING = ("rad", "each segment's bend theta (cos phi, sin phi), mean of its joints' encoders")
NEXT = "next_"


@dataclasses.dataclass(frozen=True)
class DeployedController:
    """Both functions, and which arrays go where."""

    begin: DeployedFunction
    """target, base_lengths, reading -> the state before the first step."""
    step: DeployedFunction
    """State and reading -> next state and motor angles."""

    @property
    def carried(self) -> tuple[str, ...]:
        """What changes from step to step."""
        return tuple(_CARRIED)


def deployed_controller(
    robot: Robot,
    begin: Callable[..., Mapping[str, jax.Array]],
    step: Callable[[Mapping[str, Any], jax.Array], Mapping[str, jax.Array]],
    precision: Precision,
) -> DeployedController:
    """The functions of a controller with the names, sizes and units of what goes in and out.

    Args:
        begin: target (9,), base command (num_cables,), reading (segments, 2) -> state by name.
        step: state, reading -> next state by name.
    Raises:
        ValueError: the state holds something else than is described here.
    """
    shapes = _shapes(robot, begin, precision)
    if shapes.keys() != {*_FIXED, *_CARRIED, READING}:
        raise ValueError(f"state: got {sorted(shapes)}, described: {sorted({*_FIXED, *_CARRIED, READING})}")
    ports = {name: _port(name, shapes[name], precision) for name in (*_FIXED, *_CARRIED, READING)}
    first = [ports[name] for name in ("target", "base_lengths", READING)]
    radius = verb(robot, "interface").pulley_radius(robot)

    def begins(target: jax.Array, base_lengths: jax.Array, reading: jax.Array) -> Outputs:
        state = begin(target, base_lengths, reading)
        return {name: state[name] for name in (*_ANSWERED, *_CARRIED)}

    def steps(*arrays: jax.Array) -> Outputs:
        state = dict(zip(ports, arrays, strict=True))
        following = step(state, state[READING])
        angles = {"motor_angles": following["command"] / radius}
        return {NEXT + name: following[name] for name in _CARRIED} | angles

    following = [dataclasses.replace(ports[name], name=NEXT + name) for name in _CARRIED]
    angles = Port("motor_angles", (robot.num_cables,), "rad", "next_command over the pulley radius; order: motors")
    return DeployedController(
        DeployedFunction("begin_target", begins, tuple(first), tuple(ports[name] for name in (*_ANSWERED, *_CARRIED))),
        DeployedFunction("control_step", steps, tuple(ports.values()), (*following, angles)),
    )


def _shapes(robot: Robot, begin: Callable[..., Any], precision: Precision) -> dict[str, jax.ShapeDtypeStruct]:
    arrays = [
        jax.ShapeDtypeStruct(shape, precision) for shape in ((9,), (robot.num_cables,), configuration_shape(robot))
    ]
    return dict(jax.eval_shape(begin, *arrays))


def _port(name: str, shape: jax.ShapeDtypeStruct, precision: Precision) -> Port:
    unit, meaning = (_FIXED | _CARRIED | {READING: _READING})[name]
    return Port(name, shape.shape, unit, meaning, None if shape.dtype == precision else str(shape.dtype))


PROTOCOL = {
    "target": "at home, once a target: begin_target; base_lengths is any inverse kinematics' answer, say inverse_kinematics'",
    "period": "every control period: control_step with all that begin_target gave and took, the carried arrays and the newest "
    "reading (the first reading twice: begin_target, then control_step); motors get motor_angles, next_X is X of the next period",
    "limits": "next_command keeps to the largest motor speed and to the strokes of the cables",
    "faults": "when a reading is stale, not finite or outside `readings`, or an answer not finite: hold the last command, keep "
    "the state, go on with the next good reading",
}
