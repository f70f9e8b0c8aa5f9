"""Least in all, and ties broken as scipy does: a fleet's shares have not changed with the algorithm."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from agent.mapf.linear_assignment import NOBODY, assigned

sides = st.tuples(st.integers(1, 9), st.integers(1, 9))
# Few values: many ties. Many: millimetres, and what is out of reach.
few = sides.flatmap(lambda side: arrays(np.int64, side, elements=st.integers(0, 3)))
many = sides.flatmap(
    lambda side: arrays(np.int64, side, elements=st.one_of(st.integers(0, 10**6), st.just(1 << 40)))
)


@settings(deadline=None)  # the kernel is compiled at the first
@given(st.one_of(few, many))
def test_rows_get_the_columns_that_scipy_gives_them(cost: NDArray[np.int64]) -> None:
    columns = assigned(cost)
    rows = np.flatnonzero(columns != NOBODY)
    assert (rows.tolist(), columns[rows].tolist()) == tuple(
        side.tolist() for side in linear_sum_assignment(cost)
    )


def test_of_equal_costs_the_first_come_first() -> None:
    assert assigned(np.ones((3, 5))).tolist() == [0, 1, 2]
    assert sorted(assigned(np.ones((5, 3))).tolist()) == [NOBODY, NOBODY, 0, 1, 2]
