"""Places in the memory of a run."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.env.memory_layout import allocate
from glbench.env.scenario import RunScenarios
from glbench.errors import TaskError
from glbench.tasks import get_task


def test_parts_have_places_of_their_own_in_the_order_given() -> None:
    layout = allocate(actuation={"heating": 18.0, "begun": 0.0}, sensors={"heating": 20.0}, other={})
    assert layout.width == 3
    assert dict(layout.of("actuation")) == {"heating": 0, "begun": 1}
    assert dict(layout.of("sensors")) == {"heating": 2}
    assert dict(layout.of("nobody")) == {}
    rows = layout.rows(2)
    assert rows.tolist() == [[18.0, 0.0, 20.0]] * 2
    rows[:] = 7.0
    assert layout.start.tolist() == [18.0, 0.0, 20.0]
    assert not layout.start.flags.writeable


def test_without_parts_a_run_remembers_nothing() -> None:
    assert allocate().rows(3).shape == (3, 0)
    assert RunScenarios(get_task("Schiphol2010-Delta00-v1")).memory_layout.width == 0


def test_a_start_that_is_no_number_is_refused() -> None:
    with pytest.raises(TaskError, match=r"'held' of the sensors starts at nan"):
        allocate(sensors={"held": float("nan")})


def test_runs_start_with_what_the_parts_asked_for() -> None:
    scenarios = RunScenarios(get_task("SpringSetpoints-v1"))
    memory = scenarios.draw([1, 2]).memory
    assert memory.shape == (2, scenarios.memory_layout.width)
    assert (memory == scenarios.memory_layout.start).all()
    assert np.isfinite(memory).all()
