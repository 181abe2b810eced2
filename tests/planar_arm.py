"""A toy kind of robot: two links in a plane, each joint turned by a loop of two strands. It proves what a kind must offer."""

from typing import Annotated, Any, Literal
from xml.etree import ElementTree

import jax
import jax.numpy as jnp
from flax import struct

from qjrl.config import Range, configuration
from qjrl.robot.kind import Kind, Robot
from qjrl.robot.limits import Box
from qjrl.robot.mjcf_text import add_element
from qjrl.robot.solver_options import SolverOptions

# Pulley radius [m], limit of both joints [rad], stiffness of a strand [N/m], masses of the links [kg].
PULLEY, LIMIT, STIFFNESS, PRETENSION, MASS = 0.02, 1.2, 20_000.0, 20.0, 0.05
# Cable 2 runs over joint 1, too: lengths = CABLES @ angles [m/rad].
CABLES = -PULLEY * jnp.array([[1.0, 0.0], [1.0, 1.0]])


@configuration
class PlanarArmConfig:
    kind: Literal["planar_arm"]
    schema: Literal[1]
    name: str
    link_length: Annotated[float, Range(above=0.0)]


@struct.dataclass
class PlanarArm(Robot):
    link_length: Any

    kind = "planar_arm"
    name = "toy"
    num_cables, num_strands, num_positions = 2, 4, 2
    motor_speed, motor_force, strand_friction, payload = 0.5, 100.0, 0.0, 0.0

    @property
    def config(self) -> PlanarArmConfig:
        return PlanarArmConfig("planar_arm", 1, self.name, float(self.link_length))


def forward_kinematics(arm: PlanarArm, angles: jax.Array) -> jax.Array:
    first, second = jnp.cumsum(angles)
    x = arm.link_length * (jnp.sin(first) + jnp.sin(second))
    z = arm.link_length * (jnp.cos(first) + jnp.cos(second))
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    return jnp.stack([x, zero, z, jnp.cos(second), zero, -jnp.sin(second), zero, one, zero])


def strand_commands(arm: PlanarArm, lengths: jax.Array) -> jax.Array:
    del arm
    return jnp.stack([lengths, -lengths], axis=1).reshape(-1) - PRETENSION / STIFFNESS


def build_mjcf(arm: PlanarArm, options: SolverOptions) -> str:
    root, length = ElementTree.Element("mujoco", model=arm.name), float(arm.link_length)
    add_element(root, "compiler", angle="radian", inertiafromgeom="auto")
    add_element(root, "option", timestep=options.timestep, integrator="implicitfast", jacobian="dense", tolerance=1e-10)
    body, tendon, actuator = (add_element(root, tag) for tag in ("worldbody", "tendon", "actuator"))
    for number in range(2):
        body = add_element(body, "body", pos=(0.0, 0.0, number * length))
        turn = {"damping": 0.05 * options.damping_scale, "armature": 1e-3 * options.armature_scale}
        add_element(body, "joint", name=f"joint_{number}", axis="0 1 0", **turn)
        add_element(body, "geom", type="capsule", mass=MASS, size=(0.005,), fromto=(0.0, 0.0, 0.0, 0.0, 0.0, length))
    add_element(body, "site", name="tip", pos=(0.0, 0.0, length))
    for strand in range(4):
        fixed = add_element(tendon, "fixed", name=f"strand_{strand}", damping=10.0 * options.strand_damping_scale)
        for joint in range(1 + strand // 2):
            add_element(fixed, "joint", joint=f"joint_{joint}", coef=PULLEY if strand % 2 else -PULLEY)
        servo = {"kp": STIFFNESS, "forcelimited": True, "forcerange": (-500.0, 0.0)}
        add_element(actuator, "position", tendon=f"strand_{strand}", **servo)
    return ElementTree.tostring(root, encoding="unicode")


PLANAR_ARM = Kind(
    description=PlanarArmConfig,
    make=lambda config: PlanarArm(config.link_length),
    home=lambda arm: jnp.zeros(2),
    limits=lambda arm: Box(jnp.full(2, -LIMIT), jnp.full(2, LIMIT)),
    forward_kinematics=forward_kinematics,
    from_unit_cube=lambda arm, numbers: LIMIT * (2.0 * numbers - 1.0),
    largest=lambda arm: jnp.full(2, LIMIT),
    random=lambda arm, key: jax.random.uniform(key, (2,), minval=-LIMIT, maxval=LIMIT),
    cable_lengths=lambda arm, angles: CABLES @ angles,
    configuration_from_cables=lambda arm, lengths: jnp.linalg.solve(CABLES, lengths),
    cable_strokes=lambda arm: jnp.sum(jnp.abs(CABLES), axis=1) * LIMIT,
    strand_commands=strand_commands,
    motor_force=lambda arm, tension: tension[..., 0::2] - tension[..., 1::2],
    is_at_strength=lambda arm, tension: tension >= 500.0,
    build_mjcf=build_mjcf,
    joint_positions=lambda arm, angles: angles,
    configuration_from_joint_positions=lambda arm, positions: positions,
    reach=lambda arm: 2.0 * float(arm.link_length),
    cable_names=lambda arm: ("cable_1", "cable_2"),
)
MAPPING = {"kind": "planar_arm", "schema": 1, "name": "toy", "link_length": 0.15}
