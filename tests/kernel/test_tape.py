"""Formulas recorded from numpy give numpy's bits when the compiled kernel does them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from glbench.kernel import Kernel, why_not_compiled
from glbench.kernel.environment import ActionBounds, Lookup, Program
from glbench.kernel.tape import OPERATORS, Recorder, RecordingError, Tape
from glbench.model import TOMATO, default_parameters

Array = np.ndarray[Any, Any]

needs_compiler = pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))


def program(outcome: Tape, width: int = 0, columns: int = 0, lookups: tuple[Lookup, ...] = ()) -> Program:
    """Nothing but a look at controls and clock."""
    bounds = ActionBounds(np.zeros(6), np.ones(6), np.zeros(6), np.ones(6))
    recorder = Recorder()
    for index in range(6):
        recorder.output("controls", index, recorder.input("given", index))
    return Program(
        actuation=recorder.tape(), outcome=outcome, actions=bounds, controls=bounds, steps=10, weather=np.zeros((12, 10)),
        day=12, days=1, calendar=np.zeros((12, 2)), lag=1, nominal=default_parameters(), lookups=lookups, columns=columns,
        width=width, info_columns=0, charges={},
    )  # fmt: skip


def played(formula: Callable[..., Any], *arguments: Array) -> Array:
    """``formula`` of some columns as a tape, whose inputs stand in the place of controls."""
    recorder = Recorder()
    recorder.output("table", 0, formula(*(recorder.input("controls", index) for index in range(len(arguments)))))
    environments = Kernel(TOMATO, 900.0, backend="compiled").environments(
        program(recorder.tape(), width=1), len(arguments[0])
    )
    assert environments is not None
    for index, values in enumerate(arguments):
        environments.u[:, index] = values
    environments.observe()
    result: Array = environments.table[:, 0].copy()
    return result


def numbers() -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    a, b = rng.normal(0.0, 1e3, 61), rng.normal(0.0, 1e-3, 61)
    special = np.array([0.0, -0.0, 1.0, np.inf, -np.inf, np.nan, 5e-324, 1e308])
    pairs = np.array(
        [(x, y) for x in special for y in special if not (x == y == 0.0)]
    )  # the larger of 0 and -0 is anyone's guess
    return np.concatenate([a, pairs[:, 0]]), np.concatenate([b, pairs[:, 1]])


FORMULAS: dict[str, Callable[[Any, Any], Any]] = {
    "sum": lambda a, b: a + b,
    "difference": lambda a, b: a - b,
    "product": lambda a, b: a * b,
    "quotient": lambda a, b: a / b,
    "minus": lambda a, b: -a,
    "larger": np.maximum,
    "smaller": np.minimum,
    "sign": lambda a, b: np.sign(a),
    "numbers on the left": lambda a, b: (2.0 - a) * 3 + 1.5 / b,
    "by name": lambda a, b: np.divide(np.subtract(a, np.float64(0.1)), np.add(np.multiply(b, 7), np.negative(b))),
    "one thing twice": lambda a, b: (a * b) + (a * b) * (a * b),
}


@needs_compiler
@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_recorded_formula_has_the_bits_of_numpy(name: str) -> None:
    a, b = numbers()
    expected, found = FORMULAS[name](a, b), played(FORMULAS[name], a, b)
    assert (np.isnan(expected) == np.isnan(found)).all()  # which not-a-number it is has no meaning
    assert np.where(np.isnan(expected), 0.0, expected).tobytes() == np.where(np.isnan(found), 0.0, found).tobytes()


@needs_compiler
def test_exp_is_the_c_librarys() -> None:
    values = np.random.default_rng(2).uniform(-50.0, 50.0, 300)

    def formula(a: Any) -> Any:
        return a._recorder.operation("exp", a)

    assert played(formula, values).tolist() == [math.exp(value) for value in values.tolist()]


@needs_compiler
def test_the_larger_of_a_number_and_none_is_the_number_in_c() -> None:
    a, b = np.array([1.0, np.nan, 2.0, 3.0]), np.array([np.nan, 1.0, 3.0, 2.0])
    for name, expected in (("fmax", [1.0, 1.0, 3.0, 3.0]), ("fmin", [1.0, 1.0, 2.0, 2.0])):
        assert played(lambda x, y, name=name: x._recorder.operation(name, x, y), a, b).tolist() == expected


@needs_compiler
def test_rows_of_tables_are_looked_up_by_clock_and_weather() -> None:
    table = np.arange(60, dtype=np.float32).reshape(12, 5)
    lookups = (Lookup(table, 0, clocked=True), Lookup(table, 5), Lookup(table, 10, rows=2, ahead=1))
    environments = Kernel(TOMATO, 900.0, backend="compiled").environments(
        program(Recorder().tape(), columns=20, lookups=lookups), 3
    )
    assert environments is not None
    environments.k[:] = [0, 1, 4]
    environments.observe()
    for row, (clock, shown) in enumerate([(0, 0), (1, 0), (4, 3)]):
        expected = [*table[clock], *table[shown], *table[shown + 1], *table[shown + 2]]
        assert environments.observations[row].tolist() == expected


def test_what_no_output_needs_is_not_on_the_tape() -> None:
    recorder = Recorder()
    a, b = recorder.input("before", 3), recorder.input("after", 3)
    _ = (a + b) * 7.0
    recorder.output("table", 0, b - 1.0)
    tape = recorder.tape()
    assert tape.constants.tolist() == [1.0]
    assert tape.inputs.tolist() == [[4, 3]]
    assert tape.operations.tolist() == [[OPERATORS.index("subtract"), 1, 0]]
    assert tape.outputs.tolist() == [[2, 0, 2]]
    assert tape.registers == 3


def test_the_same_operation_is_done_once_and_two_zeros_are_two() -> None:
    recorder = Recorder()
    a = recorder.input("after", 0)
    recorder.output("table", 0, (a + 1.0) * (a + 1.0))
    recorder.output("table", 1, a * 0.0 + a * -0.0)
    tape = recorder.tape()
    assert len(tape.operations) == 5
    assert len(tape.constants) == 3


@pytest.mark.parametrize(
    ("formula", "complaint"),
    [
        (np.exp, "uses exp"),
        (lambda a: np.maximum(a, 0.0, where=True), "uses maximum"),
        (lambda a: a**2, "power"),
        (lambda a: 2.0**a, "power"),
        (lambda a: a if a else 0.0, "decides by a number"),
        (lambda a: a + np.zeros(3), "mixes a recorded value with a ndarray"),
        (lambda a: a + "1", "mixes a recorded value with a str"),
    ],
)
def test_what_cannot_be_recorded_says_so(formula: Callable[[Any], Any], complaint: str) -> None:
    with pytest.raises(RecordingError, match=complaint):
        formula(Recorder().input("after", 0))


@needs_compiler
def test_a_program_that_is_too_large_is_declined() -> None:
    recorder = Recorder()
    value = recorder.input("controls", 0)
    for number in range(2000):
        value = value + float(number)
    recorder.output("table", 0, value)
    assert Kernel(TOMATO, 900.0, backend="compiled").environments(program(recorder.tape(), width=1), 1) is None
