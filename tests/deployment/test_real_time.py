"""The loop, what it does with bad readings, its record and the replay; in time that is short but real."""

import os
import socket
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from controllers import ARM, PERIOD, STEPS, arm, exported, targets

from qjrl import artifacts
from qjrl.artifacts import ArtifactError
from qjrl.deployment.deploy import DeployConfig, deploy
from qjrl.deployment.line import ABSURD, CORRUPT, LOST, NO_FAULT, FaultConfig, Line, draw_faults
from qjrl.deployment.live_view import live_view
from qjrl.deployment.real_time import Clock, Schedule, on_one_core, play
from qjrl.deployment.recording import as_record, flagged, load_record, replay, timing
from qjrl.deployment.safety import (
    BAD_ANSWER,
    BEYOND_STOP,
    FLAGS,
    GOOD,
    NOT_FINITE,
    STALE,
    TOO_FAST,
    SafeController,
    reading_limits,
)

READING, AGE = np.zeros((2, 2)), 0.0


class Counting:
    """Commands how often it was asked."""

    def begin(self, target, base_lengths, reading):
        self.first, self.count = reading, 0

    def step(self, reading):
        self.count += 1
        return np.full(4, float(self.count) if self.count != 3 else np.inf)


class Still:
    """An arm that remembers when it was given what."""

    timestep, pose, joint_positions = 0.004, np.zeros(9), np.zeros(1)

    def __init__(self):
        self.time, self.held = 0, []

    def read(self):
        return READING

    def hold(self, lengths):
        self.held.append((self.time, float(lengths[0])))

    def advance(self, num_steps):
        self.time += num_steps


def safe(controller=None):
    wrapped = SafeController(controller or Counting(), 0.015)
    wrapped.begin(np.zeros(9), np.zeros(4))
    return wrapped


def test_bad_readings_hold_the_last_command_and_good_ones_go_on():
    controller, bad = safe(), np.full((2, 2), np.nan)
    asked = [(READING, 0.0), (READING, 0.02), (bad, 0.0), (bad, 1.0), (READING, 0.015), (READING, 0.0), (READING, 0.0)]
    answers = [controller.step(*one) for one in asked]
    assert [flag for _, flag in answers] == [GOOD, STALE, NOT_FINITE, STALE, GOOD, BAD_ANSWER, GOOD]
    assert [command[0] for command, _ in answers] == [1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 4.0]


def test_a_finite_reading_that_no_arm_can_have_holds_the_last_command():
    limits, random = reading_limits(ARM), np.random.default_rng(0)
    stop = np.radians(ARM.config.joint.bend_limit_deg + ARM.config.joint.stop_margin_deg)
    assert stop < limits.angle < 1.2 * stop and 0.5 < limits.speed < 20.0
    for absurd in [10.0, np.pi, 1e6, 1e30, 3e38, 1e39, 1e308, *10.0 ** random.uniform(0.3, 300.0, 40)]:
        controller = SafeController(Counting(), 0.015, limits, 0.02)
        controller.begin(np.zeros(9), np.zeros(4))
        reading = random.choice([-1.0, 1.0], (2, 2)) * absurd
        answers = [controller.step(one, AGE) for one in (READING, reading, READING)]
        assert [flag for _, flag in answers] == [GOOD, BEYOND_STOP, GOOD]
        assert [command[0] for command, _ in answers] == [1.0, 1.0, 2.0]
    for rate, flag in ((0.9 * limits.speed, GOOD), (limits.speed + 1.1 * limits.jump / 0.02, TOO_FAST)):
        controller = SafeController(Counting(), 0.015, limits, 0.02)
        controller.begin(np.zeros(9), np.zeros(4))
        controller.step(READING, AGE)
        assert controller.step(np.array([[rate * 0.02, 0.0], [0.0, 0.0]]), AGE)[1] == flag
    while controller.step(np.array([[1.0, 0.0], [0.0, 0.0]]), AGE)[1] == TOO_FAST:  # it did move: believed in the end
        pass


def test_without_a_good_reading_the_arm_stays_at_home_and_begins_with_the_first_one():
    inner = Counting()
    controller = safe(inner)
    command, flag = controller.step(READING, float("nan"))
    assert flag == STALE and not command.any() and not hasattr(inner, "first")
    controller.step(READING + 1.0, AGE)
    np.testing.assert_array_equal(inner.first, READING + 1.0)


def test_the_real_controller_survives_a_reading_that_is_not_finite():
    """Asked in spite of it, it answers nothing finite and forgets that it was asked."""
    files = exported().controllers["control_step.stablehlo"]
    readings = 0.01 * np.random.default_rng(0).normal(size=(3, 2, 2))
    commands = []
    for is_asked in (False, True):
        files.begin(targets()[0][0], targets()[1][0], readings[0])
        files.step(readings[0])
        if is_asked:
            assert not np.isfinite(files.step(np.full((2, 2), np.nan))).all()
        commands.append(files.step(readings[1]))
    np.testing.assert_array_equal(*commands)


def test_a_lost_reading_is_the_last_one_again_and_faults_are_drawn_as_configured():
    line = Line(np.array([NO_FAULT, LOST, CORRUPT, NO_FAULT]))
    received = [line.receive(step, READING + step, float(step)) for step in range(4)]
    assert [stamp for _, stamp in received] == [0.0, 0.0, 2.0, 3.0]
    assert received[1][0][0, 0] == 0.0 and np.isnan(received[2][0]).all() and received[3][0][0, 0] == 3.0
    faults = draw_faults(FaultConfig(0.1, 3), 20_000, seed=0)
    assert faults[0] == NO_FAULT and 0.1 < np.mean(faults != NO_FAULT) < 0.2
    assert 0.8 < np.sum(faults == LOST) / np.sum(faults == CORRUPT) < 1.25


class SlowTime:
    """A clock that goes on when it is looked at, and when somebody sleeps."""

    def __init__(self):
        self.time = 0.0

    def now(self):
        self.time += 1e-5
        return self.time

    def sleep(self, seconds):
        self.time += seconds


def schedule(time, num_periods):
    return Schedule(num_periods, PERIOD, Clock(time.now, time.sleep))


def test_a_command_in_time_is_held_from_the_begin_of_its_period_and_a_late_one_from_when_it_comes():
    class Slow(Counting):
        def step(self, reading):
            if self.count == 1:
                time.sleep(2.3 * PERIOD)  # 46 ms: two periods go by, of the third 6 ms
            return super().step(reading) if self.count != 2 else np.full(4, 9.0)

    plant, time = Still(), SlowTime()
    played = play(safe(Slow()), plant, (np.zeros(9), np.zeros(4)), schedule(time, 6), Line(np.zeros(6, int)))
    assert played.lost_periods == 2 and played.period.tolist() == [0, 1, 4, 5]
    assert plant.time == 6 * 5 and [when for when, _ in plant.held] == [0, 5 + 11, 20, 25]
    np.testing.assert_allclose(played.latency, [1e-5, 0.046, 1e-5, 1e-5], atol=2e-5)
    record = as_record([played], (np.zeros((0, 9)), np.zeros((0, 4))), PERIOD, "")
    measured = timing(record)
    assert measured["deadlines_missed"] == 1 and measured["latency_max_ms"] == pytest.approx(46.0, abs=0.1)


@pytest.fixture(scope="module")
def record():
    """Two targets and the first again with faults, with the real files and the real arm."""
    files = exported().controllers["control_step.stablehlo"]
    controller = SafeController(files, 0.015, reading_limits(ARM), PERIOD)
    config = DeployConfig(faults=FaultConfig(0.1, 5))
    episodes = list(deploy(controller, arm(), targets(), schedule(SlowTime(), STEPS), config, seed=1))
    return as_record(episodes, targets(), PERIOD, "this arm", controller.limits)


def test_in_real_time_the_loop_keeps_its_clock():
    begin = time.perf_counter()
    played = play(safe(), Still(), (np.zeros(9), np.zeros(4)), Schedule(10, 0.02), Line(np.zeros(10, int)))
    assert time.perf_counter() - begin >= 10 * 0.02 and len(played.period) + played.lost_periods == 10
    assert np.all(played.lateness >= 0.0) and np.all(played.latency > 0.0)


def test_the_injected_faults_are_the_flagged_ones_and_the_arm_still_arrives(record):
    rows = record["episode"] == 2
    faults = draw_faults(FaultConfig(0.1, 5), STEPS, 1)[record["period"][rows]]
    flags = record["flag"][rows]
    assert np.all(flags[faults == NO_FAULT] == GOOD) and np.all(flags[faults != NO_FAULT] != GOOD)
    counted = flagged(record, 2)
    assert sum(counted[name] for name in FLAGS) == np.sum(rows)
    assert counted["beyond_stop"] == np.sum(faults == ABSURD) > 0
    held = np.flatnonzero(rows)[1:][flags[1:] != GOOD]
    np.testing.assert_array_equal(record["command"][held], record["command"][held - 1])
    missing = np.linalg.norm(record["pose"][:, :3] - record["target"][record["episode"], :3], axis=1)
    last = [np.flatnonzero(record["episode"] == episode)[-1] for episode in range(3)]
    assert missing[last].max() < 0.02 and not flagged(record, 0)["stale"]


def test_a_replay_repeats_every_command_bit_for_bit_and_notices_another(record, tmp_path):
    controller = SafeController(exported().controllers["control_step.stablehlo"], 0.015)
    artifacts.write_arrays(tmp_path / "log.npz", record)
    found = replay(controller, load_record(tmp_path / "log.npz", "this arm"))
    assert found == {
        "episodes": 3, "steps": len(record["period"]), "command_deviation": 0.0, "flags_that_differ": 0
    }  # fmt: skip
    old = {name: column for name, column in record.items() if name != "reading_limits"}
    first = old["episode"] == 0  # nothing was wrong in it: as records were before there were limits
    old |= {name: old[name][:1] for name in ("target", "base_lengths", "lost_periods", "has_faults")}
    old |= {name: column[first] for name, column in old.items() if len(np.atleast_1d(column)) == len(first)}
    artifacts.write_arrays(tmp_path / "old.npz", old)
    found = replay(controller, load_record(tmp_path / "old.npz", "this arm"))
    assert (found["command_deviation"], found["flags_that_differ"]) == (0.0, 0)
    other = dict(record) | {"command": record["command"] + 1e-3}
    assert replay(controller, other)["command_deviation"] == pytest.approx(1e-3, rel=1e-3)


def test_a_foreign_record_is_one_line(record, tmp_path):
    artifacts.write_arrays(tmp_path / "log.npz", record)
    with pytest.raises(ArtifactError, match="belongs to another robot"):
        load_record(tmp_path / "log.npz", "another")
    artifacts.write_arrays(tmp_path / "log.npz", {"pose": np.zeros(9)})
    with pytest.raises(ArtifactError, match="is no record of a deployment: it has no target"):
        load_record(tmp_path / "log.npz", "this arm")


def test_the_view_is_served_on_loopback_alone():
    plant, free = arm(), socket.socket()
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
    free.close()
    with live_view(plant.stepper.model, port) as show:
        show(plant)
        page = urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5).read()
        served = urllib.request.urlopen(f"http://127.0.0.1:{port}/model", timeout=5).read()
        lines = [line for name in ("tcp", "tcp6") for line in _lines(Path("/proc/net") / name)]
        assert {line.split()[1] for line in lines if f":{port:04X} " in line and " 0A " in line} == {
            f"0100007F:{port:04X}"
        }
        with pytest.raises(ArtifactError, match=f"deploy.port: got {port}"), live_view(plant.stepper.model, port):
            pass
    assert b"<html" in page.lower() and len(served) > 1000


def _lines(path):
    return path.read_text().splitlines()[1:] if path.exists() else []


def test_one_core_is_given_back():
    before = os.sched_getaffinity(0)
    with on_one_core() as core:
        assert os.sched_getaffinity(0) == {core}
    assert os.sched_getaffinity(0) == before
