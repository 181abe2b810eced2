import pytest
from hypothesis import given
from hypothesis import strategies as st

from qjrl.config import ConfigError
from qjrl.simulation.control_period import substeps_of


@pytest.mark.parametrize(("period", "timestep", "count"), [(0.02, 0.004, 5), (0.02, 0.005, 4), (0.02, 0.02, 1)])
def test_a_multiple_is_counted(period, timestep, count):
    assert substeps_of(period, timestep) == count


def test_a_period_that_is_no_multiple_is_refused_with_time_steps_that_fit():
    with pytest.raises(
        ConfigError, match=r"got 0\.02 s, .* 0\.006 s; time steps that fit are 0\.00666667 and 0\.005 s"
    ):
        substeps_of(0.02, 0.006)
    with pytest.raises(ConfigError, match=r"got 0\.002 s"):
        substeps_of(0.002, 0.004)


@given(st.integers(1, 1000), st.floats(1e-4, 0.1))
def test_what_is_played_is_what_was_asked_for(count, timestep):
    assert substeps_of(count * timestep, timestep) == count


@given(st.floats(1e-3, 1.0), st.floats(1e-4, 0.1))
def test_nothing_is_rounded(period, timestep):
    try:
        count = substeps_of(period, timestep)
    except ConfigError:
        return
    assert count * timestep == pytest.approx(period, rel=1e-9)
