"""Formulas recorded with CasADi give NumPy's bits, played by NumPy and by the compiled kernel."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest

from glbench.kernel import Kernel, why_not_compiled
from glbench.kernel.environment import ActionBounds, Lookup, Program
from glbench.kernel.tape import OPERATORS, Recorder, RecordingError, Tape, TapeDerivatives, with_simplification
from glbench.model import TOMATO, default_parameters
from glbench.model.expressions import simplification

Array = np.ndarray[Any, Any]
Formula = Callable[..., Any]

needs_compiler = pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))


def program(outcome: Tape, width: int = 0, columns: int = 0, lookups: tuple[Lookup, ...] = ()) -> Program:
    """Nothing but a look at controls and clock."""
    bounds = ActionBounds(np.zeros(6), np.ones(6), np.zeros(6), np.ones(6))
    with Recorder() as recorder:
        for index in range(6):
            recorder.output("controls", index, recorder.input("given", index))
    return Program(
        actuation=recorder.tape(), outcome=outcome, actions=bounds, controls=bounds, steps=10, weather=np.zeros((12, 10)),
        day=12, days=1, calendar=np.zeros((12, 2)), lag=1, nominal=default_parameters(), lookups=lookups, columns=columns,
        width=width, info_columns=0, charges={},
    )  # fmt: skip


def recorded(formula: Formula, count: int = 2) -> Tape:
    with Recorder() as recorder:
        recorder.output("table", 0, formula(*(recorder.input("controls", index) for index in range(count))))
    return recorder.tape()


def compiled(tape: Tape, *arguments: Array) -> Array:
    """What the compiled kernel makes of some columns, which stand in the place of controls."""
    environments = Kernel(TOMATO, 900.0, backend="compiled").environments(program(tape, width=1), len(arguments[0]))
    assert environments is not None
    for index, values in enumerate(arguments):
        environments.u[:, index] = values
    environments.observe()
    result: Array = environments.table[:, 0].copy()
    return result


def in_numpy(tape: Tape, *arguments: Array) -> Array:
    ((_, _, values),) = tape.play(lambda source, index: arguments[index])
    return np.array(np.broadcast_to(values, arguments[0].shape))


def numbers() -> tuple[Array, Array]:
    """Pairs of random numbers, and all pairs of special ones: ties, zeros of both signs, infinities, NaN."""
    rng = np.random.default_rng(1)
    a, b = rng.normal(0.0, 1e3, 61), rng.normal(0.0, 1e-3, 61)
    special = np.array([0.0, -0.0, 1.0, -1.0, 2.5, np.inf, -np.inf, np.nan, 5e-324, 1e308])
    pairs = np.array([(x, y) for x in special for y in special])
    return np.concatenate([a, pairs[:, 0]]), np.concatenate([b, pairs[:, 1]])


def bits(values: Array) -> bytes:
    """The bits; which not-a-number one is has no meaning."""
    return np.where(np.isnan(values), np.nan, values).tobytes()


def second_of_equal(choose: Formula) -> Formula:
    """NumPy's maximum or minimum; of equal operands, so of two zeros, the second."""
    return lambda a, b: np.where(a == b, b, choose(a, b))


def by_number(function: Callable[..., float]) -> Formula:
    """A function of the C library's; what Python refuses is what NumPy makes of it."""

    def one(*values: float) -> float:
        try:
            return function(*values)
        except (ValueError, OverflowError):
            name = {"pow": "power"}.get(function.__name__, function.__name__)
            return float(getattr(np, name)(*values))

    return lambda *columns: np.array([one(*row) for row in zip(*(column.tolist() for column in columns), strict=True)])


FORMULAS: dict[str, tuple[Formula, Formula | None]] = {
    "sum": (lambda a, b: a + b, None),
    "difference": (lambda a, b: a - b, None),
    "product": (lambda a, b: a * b, None),
    "quotient": (lambda a, b: a / b, None),
    "minus": (lambda a, b: -a, None),
    "larger": (np.maximum, second_of_equal(np.maximum)),
    "smaller": (np.minimum, second_of_equal(np.minimum)),
    "larger, in CasADi": (casadi.fmax, second_of_equal(np.maximum)),
    "smaller, in CasADi": (casadi.fmin, second_of_equal(np.minimum)),
    "larger than 0": (lambda a, b: np.maximum(a, 0.0), lambda a, b: np.where(a == 0.0, 0.0, np.maximum(a, 0.0))),
    "sign": (lambda a, b: np.sign(a), None),
    "magnitude": (lambda a, b: abs(a), None),
    "square root": (lambda a, b: np.sqrt(a), None),
    "exp": (lambda a, b: casadi.exp(a), lambda a, b: by_number(math.exp)(a)),
    "log": (lambda a, b: casadi.log(a), lambda a, b: by_number(math.log)(a)),
    "power": (lambda a, b: a**b, by_number(math.pow)),
    "power of a number": (lambda a, b: 1.25**b, lambda a, b: by_number(math.pow)(np.full_like(b, 1.25), b)),
    "cube": (lambda a, b: a**3, lambda a, b: by_number(math.pow)(a, np.full_like(a, 3.0))),
    "less": (lambda a, b: a < b, None),
    "at most": (lambda a, b: a <= b, None),
    "more": (lambda a, b: a > b, None),
    "equal": (lambda a, b: a == b, None),
    "unequal": (lambda a, b: a != b, None),
    "not": (lambda a, b: casadi.logic_not(a), lambda a, b: a == 0.0),
    "and": (casadi.logic_and, lambda a, b: (a != 0.0) & (b != 0.0)),
    "or": (casadi.logic_or, lambda a, b: (a != 0.0) | (b != 0.0)),
    "choice": (lambda a, b: casadi.if_else(a < b, a, b), lambda a, b: np.where(a < b, a, 0.0) + np.where(a < b, 0.0, b)),
    "numbers on the left": (lambda a, b: (2.0 - a) * 3 + 1.5 / b, None),
    "by name": (lambda a, b: np.divide(np.subtract(a, np.float64(0.1)), np.add(np.multiply(b, 7), np.negative(b))), None),
    "what simplifies": (lambda a, b: (a - a) + (b * 0.0) + 1.0 * (a / a) + (0.0 - (-b)) + 2.0 * (0.5 * a), None),
    "one thing twice": (lambda a, b: (a * b) + (a * b) * (a * b), None),
}


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_recorded_formula_has_the_bits_of_numpy(name: str) -> None:
    a, b = numbers()
    formula, expected = FORMULAS[name]
    tape, values = recorded(formula), np.asarray((expected or formula)(a, b), dtype=np.float64)
    assert bits(in_numpy(tape, a, b)) == bits(values)
    if why_not_compiled() is None:
        assert bits(compiled(tape, a, b)) == bits(values)


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_casadi_gives_the_same_numbers_of_the_expression(name: str) -> None:
    """But for NaN and zeros in maxima, minima and signs, where it does as the C library does."""
    a, b = numbers()
    formula, expected = FORMULAS[name]
    with simplification(on=False):
        x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
        function = casadi.Function("f", [x, y], [formula(x, y)])
    values = np.asarray(function(a[None], b[None])).ravel()
    wanted = np.asarray((expected or formula)(a, b), dtype=np.float64)
    clear = ~(np.isnan(a) | np.isnan(b)) | ("larger" not in name and "smaller" not in name)
    same = (values == wanted) | (np.isnan(values) & np.isnan(wanted))
    assert same[clear].all()
    if name not in ("sign", "larger", "smaller", "larger, in CasADi", "smaller, in CasADi", "larger than 0"):
        assert bits(values) == bits(wanted)


def test_every_operator_is_tested() -> None:
    used = {OPERATORS[operator] for formula, _ in FORMULAS.values() for operator in recorded(formula).operations[:, 0]}
    assert used == set(OPERATORS)


def test_every_shape_can_be_played() -> None:
    a, b = np.random.default_rng(3).uniform(0.5, 2.0, (2, 4, 3))
    for formula, _ in FORMULAS.values():
        assert in_numpy(recorded(formula), a, b).ravel().tolist() == in_numpy(recorded(formula), a.ravel(), b.ravel()).tolist()


@needs_compiler
def test_rows_of_tables_are_looked_up_by_clock_and_weather() -> None:
    table = np.arange(60, dtype=np.float32).reshape(12, 5)
    lookups = (Lookup(table, 0, clocked=True), Lookup(table, 5), Lookup(table, 10, rows=2, ahead=1))
    environments = Kernel(TOMATO, 900.0, backend="compiled").environments(program(Recorder().tape(), columns=20, lookups=lookups), 3)
    assert environments is not None
    environments.k[:] = [0, 1, 4]
    environments.observe()
    for row, (clock, shown) in enumerate([(0, 0), (1, 0), (4, 3)]):
        expected = [*table[clock], *table[shown], *table[shown + 1], *table[shown + 2]]
        assert environments.observations[row].tolist() == expected


def test_what_no_output_needs_is_not_on_the_tape() -> None:
    with Recorder() as recorder:
        a, b = recorder.input("before", 3), recorder.input("after", 3)
        _ = (a + b) * 7.0
        recorder.output("table", 0, b - 1.0)
    tape = recorder.tape()
    assert tape.constants.tolist() == [1.0]
    assert tape.inputs.tolist() == [[4, 3]]
    assert tape.operations.tolist() == [[OPERATORS.index("subtract"), 1, 0]]
    assert tape.outputs.tolist() == [[2, 0, 2]]
    assert tape.registers == 3
    assert tape.reads("after")
    assert not tape.reads("before")


def test_the_same_operation_is_done_once() -> None:
    tape = recorded(lambda a, b: (a + 1.0) * (a + 1.0))
    assert len(tape.operations) == 2


def test_inputs_and_numbers_are_outputs_as_they_are() -> None:
    with Recorder() as recorder:
        a = recorder.input("after", 0)
        for index, value in enumerate((a, 7.0, 0, a)):
            recorder.output("table", index, value)
    played = recorder.tape().play(lambda source, index: np.array([3.0, 4.0]))
    assert [np.asarray(values).tolist() for _, _, values in played] == [[3.0, 4.0], 7.0, 0.0, [3.0, 4.0]]


def test_a_constant_zero_has_no_sign() -> None:
    assert in_numpy(recorded(lambda a: a * -0.0, 1), np.array([1.0, -1.0])).tobytes() == np.array([0.0, -0.0]).tobytes()


@pytest.mark.parametrize(
    ("formula", "complaint"),
    [
        (np.cos, "OP_COS, which cannot be recorded"),
        (lambda a: a if a else 0.0, "decides by a number"),
        (lambda a: max(a, 0.0), "decides by a number"),
        (lambda a: a + np.zeros(3), r"array of shape \(3, 1\)"),
        (lambda a: a + "1", "unsupported operand"),
        (lambda a: np.array([a, a]), "makes a ndarray"),
        (lambda a: math.exp(a), "makes a number of what is known only in the step"),
        (float, "makes a number of what is known only in the step"),
        (lambda a: a**math.nan, "makes a number"),
        (lambda a: 1.0 if a is None else [a], "makes a list"),
    ],
)
def test_what_cannot_be_recorded_says_so(formula: Formula, complaint: str) -> None:
    with pytest.raises(RecordingError, match=complaint):
        recorded(formula, 1)


def test_nothing_is_recorded_outside_of_the_block() -> None:
    recorder = Recorder()
    with pytest.raises(RecordingError, match="with block"):
        recorder.input("after", 0)
    with recorder:
        recorder.input("after", 0)
    with pytest.raises(RecordingError, match="with block"):
        recorder.input("after", 0)


def settings() -> tuple[bool, int]:
    return casadi.GlobalOptions.getSimplificationOnTheFly(), casadi.GlobalOptions.getNumpyMode()


def test_casadis_settings_return_after_a_recording_and_after_an_error() -> None:
    before = settings()
    with Recorder():
        assert settings() == (False, -1)
        with Recorder():
            pass
        assert settings() == (False, -1)
        with_simplification(lambda: casadi.SX(1.0))
        assert settings() == (False, -1)
    assert settings() == before
    with pytest.raises(ZeroDivisionError), Recorder():
        _ = 1 / 0
    assert settings() == before


def test_a_model_has_its_digest_while_another_thread_records() -> None:
    from glbench.model import model

    digest = TOMATO.digest
    model._symbolic_model.cache_clear()
    model._rhs_function.cache_clear()
    found: list[str] = []
    with Recorder():
        function = TOMATO.rhs_function()
    assert model.digest_of(function) == digest
    model._symbolic_model.cache_clear()
    model._rhs_function.cache_clear()
    with Recorder() as recorder:
        thread = threading.Thread(target=lambda: found.append(model.digest_of(TOMATO.rhs_function())))
        thread.start()
        thread.join(0.05)  # it waits
        recorder.output("table", 0, recorder.input("after", 0) * 1.0)
    thread.join()
    assert found == [digest]
    assert len(recorder.tape().operations) == 1


@needs_compiler
def test_a_program_that_is_too_large_is_declined() -> None:
    def formula(value: Any) -> Any:
        for number in range(2000):
            value = value + float(number)
        return value

    assert Kernel(TOMATO, 900.0, backend="compiled").environments(program(recorded(formula, 1), width=1), 1) is None


# Derivatives.

SMOOTH: dict[str, Formula] = {
    **{name: formula for name, (formula, _) in FORMULAS.items() if name not in ("exp", "log", "square root", "power")},
    "exp": lambda a, b: casadi.exp(a * 0.1) * b,
    "log and root": lambda a, b: casadi.log(a * a + 1.0) * np.sqrt(b * b + 1.0),
    "power": lambda a, b: (a * a + 0.5) ** b,
    "nested": lambda a, b: np.maximum(a * b, 0.25) / np.minimum(b + 2.0, a - 3.0) - np.maximum(0.0, np.negative(a)),
}


def linearised(formula: Formula, a: Array, b: Array, **options: Any) -> tuple[Array, Array, Array]:
    """Value and derivatives of a formula of a state and a control."""
    with Recorder() as recorder:
        recorder.output("table", 0, formula(recorder.input("before", 4), recorder.input("controls", 0)))
    derivatives = TapeDerivatives(recorder.tape(), [("table", 0)], ("before", "controls"), **options)
    slopes = {"before": np.zeros((*a.shape, 1, 5)), "controls": np.zeros((*a.shape, 1, 1))}
    (values,) = derivatives(lambda source, index: a if source == "before" else b, slopes)  # type: ignore[arg-type]
    (alone,) = derivatives.values(lambda source, index: a if source == "before" else b)
    assert np.asarray(values).tobytes() == np.asarray(alone).tobytes()
    return np.array(np.broadcast_to(values, a.shape)), slopes["before"][..., 0, 4], slopes["controls"][..., 0, 0]


@pytest.mark.parametrize("name", SMOOTH)
def test_derivatives_are_those_of_differences(name: str) -> None:
    a, b = np.random.default_rng(1).uniform(-2.0, 2.0, (2, 50, 3))
    h, formula = 1e-6, SMOOTH[name]
    values, by_state, by_control = linearised(formula, a, b)
    for slopes, da, db in ((by_state, h, 0.0), (by_control, 0.0, h)):
        ahead, behind = (linearised(formula, a + sign * da, b + sign * db)[0] for sign in (1, -1))
        np.testing.assert_allclose(slopes, (ahead - behind) / (2 * h), 1e-6, 1e-7)
    assert values.tobytes() == in_numpy(recorded(formula), a, b).tobytes()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", FORMULAS)
def test_values_beside_derivatives_have_the_bits_of_the_tape(name: str) -> None:
    a, b = numbers()
    formula, expected = FORMULAS[name]
    assert bits(linearised(formula, a, b)[0]) == bits(np.asarray((expected or formula)(a, b), dtype=np.float64))


@pytest.mark.parametrize("formula", [np.maximum, np.minimum, casadi.fmax, casadi.fmin])
def test_at_a_kink_the_second_operand_has_the_whole_derivative(formula: Formula) -> None:
    _, first, second = linearised(formula, np.ones(1), np.ones(1))
    assert (first.tolist(), second.tolist()) == ([0.0], [1.0])
    _, first, _ = linearised(lambda a, b: formula(a, 0.0), np.zeros(1), np.zeros(1))
    assert first.tolist() == [0.0]


def test_derivatives_are_of_the_first_outputs_by_the_sources_asked_for() -> None:
    with Recorder() as recorder:
        a, b = recorder.input("before", 0), recorder.input("controls", 1)
        for index, value in enumerate((a * b, a + b, 7.0)):
            recorder.output("table", index, value)
    rows = np.arange(1.0, 5.0)
    tape = recorder.tape()
    slopes = np.zeros((4, 2, 2))
    outputs = [("table", 0), ("table", 2), ("table", 1)]
    values = TapeDerivatives(tape, outputs, ("controls",), count=2)(lambda source, index: rows, {"controls": slopes})  # type: ignore[arg-type]
    assert [np.asarray(column).tolist() for column in values] == [(rows * rows).tolist(), 7.0, (rows + rows).tolist()]
    assert slopes.tolist() == [[[0.0, row], [0.0, 0.0]] for row in rows]


def test_a_change_of_an_output_counts_wherever_it_is_used() -> None:
    with Recorder() as recorder:
        excess = np.maximum(recorder.input("before", 4), 0.0)
        recorder.output("table", 0, 2.0 * excess)  # type: ignore[operator]
        recorder.output("table", 1, excess)
    square = {("table", 1): lambda value: value * value}
    derivatives = TapeDerivatives(recorder.tape(), [("table", 0)], ("before",), changes=square)  # type: ignore[arg-type]
    slopes = np.zeros((2, 1, 5))
    (values,) = derivatives(lambda source, index: np.array([-1.0, 3.0]), {"before": slopes})
    assert values.tolist() == [0.0, 18.0]
    assert slopes[:, 0, 4].tolist() == [0.0, 12.0]


def test_without_outputs_or_inputs_there_is_nothing_to_differentiate() -> None:
    assert TapeDerivatives(recorded(lambda: 7.0, 0), [], ("after",))(lambda source, index: None, {}) == []
    assert TapeDerivatives(recorded(lambda: 7.0, 0), [("table", 0)], ("after",))(lambda source, index: None, {}) == [7.0]
