"""What the `Config` of every stage has, and what holds where a stage says nothing else."""

import dataclasses
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class StageConfig:
    """Base of every stage's `Config`. Its fields are top-level keys of the configuration."""

    seed: int = dataclasses.field(kw_only=True)
    """Of everything random in the stage."""

    @property
    def robot_hash(self) -> str | None:
        """Of the robots that the stage works on, whose ConfigErrors it raises; None: it works on none."""
        return None

    @property
    def lacks(self) -> str | None:
        """What the stage needs of its robot, and robots of that kind do not offer; None: nothing."""
        return None

    @property
    def files(self) -> Mapping[str, str]:
        """Path -> hash of every file that the stage reads beside its inputs; part of the stage's identity."""
        return {}

    @property
    def packages(self) -> Mapping[str, str]:
        """What -> which, of extras that change what the stage writes; part of the stage's identity."""
        return {}

    @property
    def part(self) -> str | None:
        """Name of the part of the stage that this process makes; None: all of it."""
        return None

    def parts(self) -> "Mapping[str, StageConfig]":
        """Name -> `Config` of every part that the whole is made of; none where a stage has no parts."""
        return {}

    def whole(self) -> "StageConfig":
        """The `Config` of all of the stage, the same for every part."""
        return self

    def check(self) -> None:
        """Raises the ConfigError of fields that each are allowed and together are not, or of a file that cannot be read.

        It is asked before any work, and only of stages that are to run.
        """


@dataclasses.dataclass(frozen=True)
class RobotStageConfig(StageConfig):
    """Base of the `Config` of a stage that works on the robot of the configuration."""

    robot: dict
    """The description of the robot as plain values."""

    needs = tuple[str, ...]()
    """What the robot's kind must offer for the stage to run: fields of `qjrl.robot.kind.Kind`."""

    @property
    def robot_hash(self) -> str | None:
        """Of that robot."""
        from qjrl.robot import robot_from_mapping, robot_hash

        return robot_hash(robot_from_mapping(self.robot))

    @property
    def lacks(self) -> str | None:
        """The first of its needs that the robot's kind does not offer."""
        from qjrl.robot.kinds import KINDS

        kind = KINDS[self.robot["kind"]]
        return next((need for need in self.needs if getattr(kind, need) is None), None)
