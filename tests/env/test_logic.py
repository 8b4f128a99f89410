"""Decisions as arithmetic, against the comparisons that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.env import process_computer as logic

numbers = st.floats(-1e9, 1e9)
conditions = st.sampled_from([0.0, 1.0])


@given(numbers, numbers)
def test_comparisons(a: float, b: float) -> None:
    assert logic.below(a, b) == float(a < b)
    assert logic.at_least(a, b) == float(a >= b)
    assert logic.below(a, a) == 0.0
    assert logic.below(a, np.nextafter(a, np.inf)) == 1.0


@given(conditions, numbers, numbers)
def test_conditions_and_choices(p: float, a: float, b: float) -> None:
    assert logic.select(p, a, b) == (a if p else b)
    assert logic.switch(p, 1.0, 1.0) == 1.0
    assert logic.switch(p, 0.0, 1.0) == 0.0
    assert logic.switch(p, 0.0, 0.0) == p


def test_shares_run_straight_and_either_way() -> None:
    value = np.array([-1.0, 0.0, 1.0, 3.0, 4.0, 9.0])
    assert logic.share(value, 0.0, 4.0).tolist() == [0.0, 0.0, 0.25, 0.75, 1.0, 1.0]
    assert logic.share(value, 4.0, 0.0).tolist() == [1.0, 1.0, 0.75, 0.25, 0.0, 0.0]
    assert logic.within(value, 0.0, 3.0).tolist() == [0.0, 0.0, 1.0, 3.0, 3.0, 3.0]


def test_a_held_switch_stays_for_its_time() -> None:
    state, steps, seen = 0.0, 1e6, []
    for wanted in (1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0):
        state, steps = logic.held_switch(state, steps, wanted, 3.0)
        seen.append(float(state))
    assert seen == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert steps == pytest.approx(1.0)
