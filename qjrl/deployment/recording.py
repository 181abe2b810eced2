"""The record of a deployment as arrays: written, read back, played again through a controller, and summed up."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.deployment.real_time import Played
from qjrl.deployment.safety import ASKED, FLAGS, GOOD, UNLIMITED, SafeController
from qjrl.robot.interface import ReadingLimits

Record = Mapping[str, np.ndarray]
"""The columns of `Played` for all periods below each other; `episode` (n,) says which; for every episode `target` (k, 9),
`base_lengths` (k, num_cables), `lost_periods` (k,), `has_faults` (k,); `control_period`, `robot_hash`; and `reading_limits`
(3,), the fields of `ReadingLimits`, which old records do not have: their readings were held against none."""

_ROWS = tuple(field.name for field in dataclasses.fields(Played) if field.name != "lost_periods")
_OF_EPISODES = ("base_lengths", "lost_periods", "has_faults")
_ABOUT = ("target", "base_lengths", "lost_periods", "has_faults", "control_period", "robot_hash", "episode")


def as_record(
    episodes: Sequence[Played],
    targets: tuple[np.ndarray, np.ndarray],
    control_period: float,
    robot_hash: str,
    limits: ReadingLimits = UNLIMITED,
) -> Record:
    """The record of a `deploy`ment: an episode for each of the targets (k, 9) and base commands (k, num_cables) [m], and the
    first of them once more, with faults."""
    rows = {name: np.concatenate([getattr(one, name) for one in episodes]) for name in _ROWS}
    target, base_lengths = (np.concatenate([column, column[:1]]) for column in targets)
    about = {
        "target": target,
        "base_lengths": base_lengths,
        "lost_periods": np.array([one.lost_periods for one in episodes]),
        "has_faults": np.arange(len(target)) == len(target) - 1,
        "control_period": np.array(control_period),
        "robot_hash": np.array(robot_hash),
        "reading_limits": np.array(dataclasses.astuple(limits)),
        "episode": np.concatenate([np.full(len(one.period), number) for number, one in enumerate(episodes)]),
    }
    return about | rows


def load_record(path: Path, robot_hash: str) -> Record:
    """A record from its file.

    Raises:
        ArtifactError: there is none, it is not one, or it is another robot's.
    """
    columns = artifacts.load(path)
    missing = [name for name in (*_ABOUT, *_ROWS) if name not in columns]
    if missing:
        raise ArtifactError(f"deploy.replay: {path} is no record of a deployment: it has no {missing[0]}")
    if str(columns["robot_hash"]) != robot_hash:
        raise ArtifactError(f"deploy.replay: {path} belongs to another robot")
    for names, of in ((_ROWS, "episode"), (_OF_EPISODES, "target")):
        for name in names:
            if len(np.atleast_1d(columns[name])) != len(columns[of]):
                raise ArtifactError(
                    f"deploy.replay: {path} is no record of a deployment: {name} {columns[name].shape} does not go with {of} "
                    f"{columns[of].shape}"
                )
    return columns


def limits_of(record: Record) -> ReadingLimits:
    """Those that the readings of a record were held against."""
    return ReadingLimits(*record["reading_limits"].tolist()) if "reading_limits" in record else UNLIMITED


def replay(controller: SafeController, record: Record) -> dict[str, Any]:
    """Put the recorded readings through a controller again, held against the recorded limits: largest deviation of its
    commands [m], flags that differ."""
    largest, flags = 0.0, 0
    controller = controller.with_limits(limits_of(record), float(record["control_period"]))
    for episode, target in enumerate(record["target"]):
        controller.begin(target, record["base_lengths"][episode])
        for row in np.flatnonzero(record["episode"] == episode):
            command, flag = controller.step(record["reading"][row], float(record["age"][row]))
            largest = max(largest, float(np.max(np.abs(command - record["command"][row]))))
            flags += int(flag != record["flag"][row])
    return {
        "episodes": len(record["target"]),
        "steps": len(record["episode"]),
        "command_deviation": largest,
        "flags_that_differ": flags,
    }


def timing(record: Record) -> dict[str, Any]:
    """Latency where the controller was asked, jitter of the periods' begin, and what was missed, over all episodes.

    Raises:
        ArtifactError: it never was asked.
    """
    if not np.isin(record["flag"], ASKED).any():
        raise ArtifactError(
            f"deploy: none of the {len(record['flag'])} readings was used, the first is {FLAGS[int(record['flag'][0])]}; look at "
            "deploy.largest_age and at the encoders"
            if len(record["flag"])
            else "deploy: the record holds no reading"
        )
    latency, lateness = 1e3 * record["latency"], 1e3 * record["lateness"]
    quantiles = {
        f"{name}_{label}_ms": float(np.quantile(values, share))
        for name, values in (("latency", latency[np.isin(record["flag"], ASKED)]), ("jitter", lateness))
        for label, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0))
    }
    return {
        "periods": len(latency),
        **quantiles,
        "deadlines_missed": int(np.sum(latency + lateness > 1e3 * record["control_period"])),
        "periods_lost": int(record["lost_periods"].sum()),
    }


def flagged(record: Record, episode: int) -> dict[str, int]:
    """How often each flag stands in an episode, and the most periods in a row in which the last command was held."""
    flags = record["flag"][record["episode"] == episode]
    longest = current = 0
    for is_bad in flags != GOOD:
        current = current + 1 if is_bad else 0
        longest = max(longest, current)
    return {name: int(np.sum(flags == index)) for index, name in enumerate(FLAGS)} | {"longest_hold": longest}
