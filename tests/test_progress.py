import pytest

from qjrl import progress


def test_without_a_terminal_a_loop_ends_with_one_line_of_count_time_and_rate(capsys) -> None:
    with progress.track(1000, "settling") as advance:
        for _ in range(10):
            advance(100, note="[3 unsettled]")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("settling: 1,000/1,000 in 0:00, ")
    assert lines[0].endswith("/s  [3 unsettled]")


def test_without_a_terminal_lines_come_at_most_every_interval_and_say_what_is_left(capsys, monkeypatch) -> None:
    clock = iter(range(0, 1000, 4))  # every look at the clock is four seconds later
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(clock)))
    with progress.track(100, "fitting", already=50) as advance:
        for _ in range(5):
            advance(10)
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["fitting: 80/100 in 0:12, 2.5/s, 0:08 left", "fitting: 100/100 in 0:24, 2.08/s"]


def test_a_loop_that_breaks_off_does_not_claim_to_be_finished(capsys) -> None:
    with pytest.raises(KeyboardInterrupt), progress.track(10, "settling") as advance:
        advance(3)
        raise KeyboardInterrupt
    assert "10/10" not in capsys.readouterr().out


def test_compiling_is_said_before_it_begins(capsys) -> None:
    with progress.compiling("the policy"):
        assert capsys.readouterr().out == "compiling the policy …\n"
