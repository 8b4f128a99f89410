"""Derivatives of tapes against differences, at kinks as stated, and parts of tapes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from glbench.kernel.tape import OPERATORS, Recorder, Tape, Value
from glbench.kernel.tape_gradient import Playback

Array = np.ndarray[Any, Any]


def operation(name: str) -> Callable[[Value, Value], Value]:
    return lambda a, b: a._recorder.operation(name, *((a,) if name in ("negative", "sign", "exp") else (a, b)))


FORMULAS: dict[str, Callable[[Any, Any], Any]] = {
    **{name: operation(name) for name in OPERATORS},
    "of constants": lambda a, b: (3.0 - a) * 2.0 + 1.5 / b - (-a) / 4.0,
    "one thing twice": lambda a, b: (a * b) * (a * b) + a * a + a / a,
    "nested": lambda a, b: np.maximum(a * b, 0.25) / np.minimum(b + 2.0, a - 3.0) - np.maximum(0.0, np.negative(a)),
}


def recorded(formula: Callable[[Any, Any], Any]) -> Tape:
    recorder = Recorder()
    recorder.output("table", 0, formula(recorder.input("before", 4), recorder.input("controls", 0)))
    return recorder.tape()


def played(tape: Tape, a: Array, b: Array) -> Playback:
    values = {("before", 4): a, ("controls", 0): b}
    return Playback(tape, lambda source, index: values[source, index])


@pytest.mark.parametrize("name", FORMULAS)
def test_derivatives_are_those_of_differences(name: str) -> None:
    rng = np.random.default_rng(1)
    a, b = rng.uniform(-2.0, 2.0, (2, 50, 3))
    tape, h = recorded(FORMULAS[name]), 1e-6
    playback = played(tape, a, b)
    gradient = playback.gradient("table", 0, ("before", "controls"))
    for source, da, db in ((("before", 4), h, 0.0), (("controls", 0), 0.0, h)):
        ahead, behind = (played(tape, a + sign * da, b + sign * db).value("table", 0) for sign in (1, -1))
        np.testing.assert_allclose(gradient.get(source, 0.0) * np.ones_like(a), (ahead - behind) / (2 * h), 1e-6, 1e-8)  # type: ignore[call-overload]
    np.testing.assert_array_equal(playback.value("table", 0), tape.play(lambda s, i: a if s == "before" else b)[0][2])


@pytest.mark.parametrize(
    ("name", "first", "second"), [("maximum", 0.0, 1.0), ("minimum", 0.0, 1.0), ("fmax", 1.0, 0.0), ("fmin", 1.0, 0.0)]
)
def test_at_a_kink_one_operand_has_the_whole_derivative(name: str, first: float, second: float) -> None:
    one = np.ones(1)
    gradient = played(recorded(operation(name)), one, one).gradient("table", 0, ("before", "controls"))
    assert gradient == {("before", 4): first, ("controls", 0): second}


def test_only_the_sources_asked_for_are_differentiated() -> None:
    one = np.ones(1)
    playback = played(recorded(lambda a, b: a * b), one, 2.0 * one)
    assert playback.gradient("table", 0, ("controls",)) == {("controls", 0): 1.0}
    assert playback.gradient("table", 0, ("after",)) == {}


def test_what_is_the_same_in_all_rows_is_a_number() -> None:
    rows = np.arange(4.0)
    gradient = played(recorded(lambda a, b: 3.0 * a - b), rows, rows).gradient("table", 0, ("before", "controls"))
    assert gradient == {("before", 4): 3.0, ("controls", 0): -1.0}
    assert all(isinstance(slope, float) for slope in gradient.values())


def test_an_output_without_inputs_has_no_gradient() -> None:
    playback = played(recorded(lambda a, b: 7.0), np.ones(2), np.ones(2))
    assert playback.value("table", 0) == 7.0
    assert playback.gradient("table", 0, ("before", "controls")) == {}


def test_a_part_of_a_tape_has_what_it_needs_and_the_same_bits() -> None:
    recorder = Recorder()
    a, b = recorder.input("before", 4), recorder.input("controls", 0)
    product = a * b
    recorder.output("table", 0, product + 1.0)
    recorder.output("table", 1, product - 0.1)
    recorder.output("observation", 0, a / 3.0)
    tape = recorder.tape()
    part = tape.part([("table", 1)])
    assert len(part.operations) == 2
    assert part.constants.tolist() == [0.1]
    x, y = np.random.default_rng(2).normal(size=(2, 9))
    assert played(part, x, y).value("table", 1).tobytes() == played(tape, x, y).value("table", 1).tobytes()


def test_a_part_may_change_an_output_wherever_it_is_used() -> None:
    recorder = Recorder()
    excess = np.maximum(recorder.input("before", 4), 0.0)
    recorder.output("table", 0, 2.0 * excess)  # type: ignore[operator]
    recorder.output("table", 1, excess)
    part = recorder.tape().part([("table", 0)], {("table", 1): lambda value: value * value})
    assert played(part, np.array([-1.0, 3.0]), np.zeros(2)).value("table", 0).tolist() == [0.0, 18.0]
