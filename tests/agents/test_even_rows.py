"""A policy is asked so that a row's bits depend on that row only."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents.saved_policies import BLOCK, EvenRows
from glbench.errors import SubmissionError

Rows = NDArray[np.float32]


def doubled(rows: Rows) -> NDArray[np.floating]:
    return 2 * rows


def by_size_of_the_batch(rows: Rows) -> NDArray[np.floating]:
    """Rounds as some matrix products do: by how many rows there are."""
    return (rows * np.float32(1 + 1e-6 * len(rows))).astype(np.float32)


def by_place(rows: Rows) -> NDArray[np.floating]:
    """Rounds by where a row lies."""
    return (rows * (1 + np.float32(1e-6) * (np.arange(len(rows), dtype=np.float32) % 4)[:, None])).astype(np.float32)


@pytest.mark.parametrize("n", [1, 5, 32, 33, 70])
def test_every_number_of_rows_is_answered_in_order(n: int) -> None:
    rows = np.random.default_rng(n).standard_normal((n, 3)).astype(np.float32)
    assert (EvenRows(doubled, 3)(rows) == 2 * rows).all()


def test_a_policy_that_rounds_by_the_size_of_a_batch_is_asked_with_one_size() -> None:
    ask = EvenRows(by_size_of_the_batch, 3)
    rows = np.random.default_rng(0).standard_normal((40, 3)).astype(np.float32)
    together = ask(rows)
    assert ask.block == BLOCK
    assert all((ask(rows[i : i + 1]) == together[i]).all() for i in range(40))


def test_a_policy_that_rounds_by_place_is_asked_row_by_row() -> None:
    ask = EvenRows(by_place, 3)
    rows = np.random.default_rng(0).standard_normal((40, 3)).astype(np.float32)
    together = ask(rows)
    assert ask.block == 1
    assert all((ask(rows[i : i + 1]) == together[i]).all() for i in range(40))


def test_an_answer_of_another_number_of_rows_is_refused() -> None:
    with pytest.raises(SubmissionError, match=r"array of shape \(1, 3\)"):
        EvenRows(lambda rows: rows[:1], 3)
