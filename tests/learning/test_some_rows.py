import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qjrl.learning.some_rows import for_some_rows

NUM_ROWS = 40  # 16 are computed at a time
ROWS = {"a": np.arange(NUM_ROWS, dtype=np.float32) + 1, "b": np.arange(2 * NUM_ROWS, dtype=np.float32).reshape(-1, 2)}


def function(rows):
    return {"sum": rows["a"] + rows["b"].sum(axis=1), "ten": 10 * rows["b"]}


def otherwise(count=NUM_ROWS):
    return {"sum": -jnp.ones(count, jnp.float32), "ten": -jnp.ones((count, 2), jnp.float32)}


some = jax.jit(lambda needs, rows, otherwise: for_some_rows(needs, function, rows, otherwise))


def assert_as_if_all_were_computed(needs, rows=ROWS):
    found, old = some(needs, rows, otherwise(len(needs))), otherwise(len(needs))
    for name, all_computed in function(rows).items():
        mask = needs.reshape(-1, *[1] * (all_computed.ndim - 1))
        np.testing.assert_array_equal(found[name], np.where(mask, all_computed, old[name]))
        assert found[name].dtype == old[name].dtype


@given(st.lists(st.booleans(), min_size=NUM_ROWS, max_size=NUM_ROWS))
def test_the_rows_that_need_it_are_computed_and_no_others(needs):
    assert_as_if_all_were_computed(np.array(needs))


@pytest.mark.parametrize("number", [0, 1, 15, 16, 17, 32, 33, NUM_ROWS])
@pytest.mark.parametrize("is_at_the_end", [False, True])
def test_none_all_and_more_than_are_computed_at_a_time(number, is_at_the_end):
    needs = np.arange(NUM_ROWS) < number
    assert_as_if_all_were_computed(needs[::-1] if is_at_the_end else needs)


@pytest.mark.parametrize("count", [1, 5, 3000])  # fewer than are computed at a time; so many that 46 are
def test_any_number_of_rows_will_do(count):
    rng = np.random.default_rng(count)
    rows = {"a": rng.standard_normal(count, np.float32), "b": rng.integers(9, size=(count, 2)).astype(np.float32)}
    for share in (0.0, 0.1, 1.0):
        assert_as_if_all_were_computed(rng.uniform(size=count) < share, rows)


def test_no_row_that_is_not_needed_costs_anything():
    calls = []

    def counted(rows):
        jax.debug.callback(lambda ids: calls.append(len(ids)), rows)
        return rows

    compute = jax.jit(lambda needs: for_some_rows(needs, counted, jnp.arange(NUM_ROWS), jnp.arange(NUM_ROWS)))
    for number, expected in ((0, []), (16, [16]), (17, [16, 16])):
        calls.clear()
        jax.block_until_ready(compute(np.arange(NUM_ROWS) < number))
        jax.effects_barrier()
        assert calls == expected
