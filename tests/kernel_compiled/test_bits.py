"""A step has the same bits alone, in any batch, in any lane, with any width, compiler and number of threads."""

from __future__ import annotations

import shutil
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel.compiled import CompiledStepper
from glbench.model import TOMATO

Array = NDArray[np.float64]
Rows = tuple[Array, Array, Array]

pytestmark = pytest.mark.usefixtures("compiled")


def stepped(stepper: CompiledStepper, rows: Rows, p: Array, order: Sequence[int] | NDArray[np.intp]) -> Array:
    x, u, d = (np.ascontiguousarray(a[order]) for a in rows)
    out = np.empty_like(x)
    status = stepper.step_rows(x, u, d, p, out)
    assert not status.any()
    return out


@pytest.fixture(scope="module")
def expected(rows: Rows, parameters: Array) -> Array:
    """All 1,000 rows stepped one by one with one lane."""
    stepper = CompiledStepper(TOMATO, 900.0, preset="fast")
    return np.concatenate([stepped(stepper, rows, parameters, [i]) for i in range(1000)])


@pytest.mark.parametrize("size", [2, 7, 64, 1000])
def test_batches_of_any_size(rows: Rows, parameters: Array, expected: Array, size: int) -> None:
    stepper = CompiledStepper(TOMATO, 900.0, preset="fast")
    found = stepped(stepper, rows, parameters, range(size))
    assert found.tobytes() == expected[:size].tobytes()


def test_any_order_of_rows(rows: Rows, parameters: Array, expected: Array) -> None:
    order = np.random.default_rng(8).permutation(1000)
    found = stepped(CompiledStepper(TOMATO, 900.0, preset="fast"), rows, parameters, order)
    assert found.tobytes() == expected[order].tobytes()


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads(rows: Rows, parameters: Array, expected: Array, threads: int) -> None:
    found = stepped(CompiledStepper(TOMATO, 900.0, preset="fast", threads=threads), rows, parameters, range(1000))
    assert found.tobytes() == expected.tobytes()


@pytest.mark.parametrize("width", [1, 4])
def test_any_number_of_lanes(rows: Rows, parameters: Array, expected: Array, width: int) -> None:
    found = stepped(CompiledStepper(TOMATO, 900.0, preset="fast", width=width), rows, parameters, range(200))
    assert found.tobytes() == expected[:200].tobytes()


@pytest.mark.parametrize(
    "command", ["clang++", pytest.param("g++ -mno-avx512f", marks=pytest.mark.slow), pytest.param("g++ -O3", marks=pytest.mark.slow)]
)
def test_other_compilers_and_instruction_sets(
    rows: Rows, parameters: Array, expected: Array, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shutil.which(command.split()[0]) is None:
        pytest.skip(f"{command} is not installed")
    monkeypatch.setenv("CXX", command)
    stepper = CompiledStepper(TOMATO, 900.0, preset="fast")
    found = stepped(stepper, rows, parameters, range(200))
    assert command.split()[0] in str(stepper.describe()["compiler"])
    assert found.tobytes() == expected[:200].tobytes()
    alone = np.concatenate([stepped(stepper, rows, parameters, [i]) for i in range(20)])
    assert alone.tobytes() == expected[:20].tobytes()


def test_parameters_shared_or_one_set_a_row(rows: Rows, parameters: Array, expected: Array) -> None:
    stepper = CompiledStepper(TOMATO, 900.0, preset="fast")
    each = np.tile(parameters, (64, 1))
    assert stepped(stepper, rows, each, range(64)).tobytes() == expected[:64].tobytes()
    assert stepped(stepper, rows, parameters[None], range(64)).tobytes() == expected[:64].tobytes()


def test_rows_may_be_stepped_in_place(rows: Rows, parameters: Array, expected: Array) -> None:
    stepper = CompiledStepper(TOMATO, 900.0, preset="fast")
    for size in (5, 500):
        x, u, d = (a[:size].copy() for a in rows)
        assert not stepper.step_rows(x, u, d, parameters, x).any()
        assert x.tobytes() == expected[:size].tobytes()


def test_a_row_does_not_feel_a_failing_neighbour(rows: Rows, parameters: Array, expected: Array) -> None:
    x, u, d = (a[:20].copy() for a in rows)
    x[[3, 11], 4] = np.nan
    out = np.empty_like(x)
    status = CompiledStepper(TOMATO, 900.0, preset="fast").step_rows(x, u, d, parameters, out)
    good = np.setdiff1d(np.arange(20), [3, 11])
    assert np.flatnonzero(status).tolist() == [3, 11]
    assert out[good].tobytes() == expected[good].tobytes()


def test_earlier_calls_leave_no_trace(rows: Rows, parameters: Array, expected: Array) -> None:
    stepper = CompiledStepper(TOMATO, 900.0, preset="fast")
    stepped(stepper, rows, parameters, range(500, 530))
    assert stepped(stepper, rows, parameters, range(30)).tobytes() == expected[:30].tobytes()
