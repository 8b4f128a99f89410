"""The tapes of tasks give the numbers that they gave before they were recorded with CasADi."""

from __future__ import annotations

import numpy as np
import pytest

from tests.golden import tapes


@pytest.mark.parametrize("task", tapes.TASKS)
def test_the_tapes_of_a_task_give_the_same_bits(task: str) -> None:
    with np.load(tapes.FILE) as archive:
        for name, tape in tapes.tapes(task).items():
            names, values = tapes.played(tape)
            assert names == archive[f"{task}.{name}.names"].tolist()
            for output, row, expected in zip(names, values, archive[f"{task}.{name}"], strict=True):
                assert row.tobytes() == expected.tobytes(), f"{name}: {output}"


def test_the_air_has_the_same_bits() -> None:
    with np.load(tapes.FILE) as archive:
        assert tapes.air().tobytes() == archive["air"].tobytes()
