"""Whether all numbers of a table are finite."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.kernel.records import all_finite


@pytest.mark.parametrize("rows", [1, 7, 292, 293, 4096])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_value_that_is_not_finite_is_found_wherever_it_stands(rows: int, bad: float) -> None:
    for row, column in ((0, 0), (rows // 2, 13), (rows - 1, 27)):
        table = np.full((rows, 28), 1e3)
        table[row, column] = bad
        assert not all_finite(table)


def test_opposite_infinities_do_not_cancel() -> None:
    for rows in (2, 4096):
        table = np.ones((rows, 28))
        table[0, 0], table[1, 1] = np.inf, -np.inf
        assert not all_finite(table)


@pytest.mark.parametrize("rows", [0, 1, 64, 4096])
def test_finite_values_of_any_sign_and_size_are_finite(rows: int) -> None:
    values = np.random.default_rng(1).normal(size=(rows, 28)) * 1e9
    assert all_finite(values)
    assert all_finite(values.astype(np.float32))
