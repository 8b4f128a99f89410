"""Wrong inputs are refused before anything is integrated, with the row and the name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glbench.errors import ActionError, GlbenchError, ShapeError, UnknownNameError
from glbench.kernel import Kernel, make_kernel
from glbench.kernel import kernel as backends
from glbench.model import TOMATO
from tests.kernel.known_steps import Array, KnownSteps


@pytest.fixture
def inputs(steps_900: KnownSteps, p: Array) -> dict[str, Array]:
    return {"x": steps_900.x[:3].copy(), "u": steps_900.u[:3].copy(), "d": steps_900.d[:3].copy(), "p": p.copy()}


def test_a_single_state_gives_a_single_state_and_inputs_stay_as_they_were(kernel: Kernel, inputs: dict[str, Array]) -> None:
    before = {key: value.copy() for key, value in inputs.items()}
    one = kernel.step(inputs["x"][0], inputs["u"][0], inputs["d"][0], inputs["p"])
    assert one.shape == (28,)
    assert kernel.step(**inputs).shape == (3, 28)
    assert all(np.array_equal(inputs[key], before[key]) for key in inputs)


def test_one_control_and_one_weather_serve_all_rows(kernel: Kernel, inputs: dict[str, Array]) -> None:
    every = {"u": np.tile(inputs["u"][1], (3, 1)), "d": np.tile(inputs["d"][1], (3, 1))}
    one = {"u": inputs["u"][1], "d": inputs["d"][1]}
    assert np.array_equal(kernel.step(**(inputs | one)), kernel.step(**(inputs | every)))


def test_lists_and_single_precision_are_taken(kernel: Kernel, inputs: dict[str, Array]) -> None:
    coarse = inputs["x"].astype(np.float32)
    expected = kernel.step(**(inputs | {"x": coarse.astype(np.float64)}))
    assert np.array_equal(kernel.step(coarse, inputs["u"].tolist(), inputs["d"], inputs["p"]), expected)


def test_no_rows_are_no_problem(kernel: Kernel, p: Array) -> None:
    after, failures = kernel.try_step(np.empty((0, 28)), np.empty((0, 6)), np.empty((0, 10)), p)
    assert after.shape == (0, 28)
    assert failures == []


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("x", np.zeros((3, 27)), r"states x have the shape \(3, 27\); expected \(28,\) or \(rows, 28\).*co2Air"),
        ("u", np.zeros((2, 6)), "controls u have 2 rows, but the states x have 3"),
        ("d", np.zeros((3, 10, 1)), "disturbances d have the shape"),
        ("p", np.zeros((2, 208)), "parameters p have 2 rows, but the states x have 3"),
        ("p", "abc", "parameters p are not numbers"),
    ],
)
def test_a_wrong_shape_is_named(kernel: Kernel, inputs: dict[str, Array], key: str, value: Any, message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        kernel.step(**(inputs | {key: value}))


@pytest.mark.parametrize(
    ("key", "at", "name"),
    [("x", (1, 2), "state tAir"), ("u", (2, 3), "control uVent"), ("d", (0, 4), "disturbance wind"), ("p", 0, "parameter alfaLeafAir")],
)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_named(kernel: Kernel, inputs: dict[str, Array], key: str, at: Any, name: str, value: float) -> None:
    inputs[key][at] = value
    row = at[0] if isinstance(at, tuple) else 0
    with pytest.raises(ShapeError, match=rf"The {name} of row {row} is {value}\. "):
        kernel.step(**inputs)


def test_huge_finite_values_are_not_called_infinite(kernel: Kernel, inputs: dict[str, Array]) -> None:
    inputs["d"][1, 7] = 1e300  # the day's radiation sum, which the model does not read
    assert kernel.try_step(**inputs)[1] == []


@pytest.mark.parametrize("value", [-0.01, 1.0000001])
def test_a_control_outside_its_range_is_refused(kernel: Kernel, inputs: dict[str, Array], value: float) -> None:
    inputs["u"][2, 5] = value
    with pytest.raises(ActionError, match=f"uBlScr of row 2 is .*{value}.* within 0..1"):
        kernel.step(**inputs)


def test_try_step_refuses_a_single_state(kernel: Kernel, inputs: dict[str, Array]) -> None:
    with pytest.raises(ShapeError, match="use step for one state"):
        kernel.try_step(inputs["x"][0], inputs["u"][0], inputs["d"][0], inputs["p"])


@pytest.mark.parametrize("seconds", [0.0, -300.0, float("nan"), float("inf")])
def test_a_step_has_a_positive_length(seconds: float) -> None:
    with pytest.raises(ShapeError, match="must be a positive, finite number"):
        Kernel(TOMATO, seconds)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"backend": "casady"}, "no backend 'casady'. Did you mean 'casadi'"),
        ({"backend": "casadi", "preset": "fats"}, "no preset 'fats'. Did you mean 'fast'"),
        ({"backend": "cvodes", "preset": "referense"}, "no preset 'referense'. Did you mean 'reference'"),
    ],
)
def test_unknown_names_get_a_did_you_mean(settings: dict[str, str], message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        Kernel(TOMATO, 900.0, **settings)


def test_auto_takes_the_compiled_backend_where_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "why_not_compiled", lambda _model: None)
    assert backends.choose("auto") == "compiled"
    monkeypatch.setattr(backends, "why_not_compiled", lambda _model: "There is no compiler.")
    assert backends.choose("auto") == "casadi"
    assert Kernel(TOMATO, 900.0).backend == "casadi"


def test_the_choice_of_a_name_never_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    def compile_now(_model: object) -> bool:
        raise AssertionError

    monkeypatch.setattr(backends, "why_not_compiled", compile_now)
    assert [backends.choose(name) for name in backends.BACKENDS] == list(backends.BACKENDS)


def test_a_description_says_what_made_the_numbers(kernel: Kernel) -> None:
    description = kernel.describe()
    assert {"backend", "method", "absolute_tolerance", "casadi", "model_digest", "model_version"} <= set(description)
    assert description["step_seconds"] == 900.0


def test_make_kernel_takes_threads_where_there_are_any(inputs: dict[str, Array]) -> None:
    one, two = make_kernel(TOMATO, 900.0, backend="casadi"), make_kernel(TOMATO, 900.0, workers=2, backend="casadi")
    assert two.step(**inputs).tobytes() == one.step(**inputs).tobytes()
    assert two.threads == 2


@pytest.mark.parametrize("workers", [0, -1, 1.5, True])
def test_a_kernel_needs_a_whole_number_of_workers(workers: Any) -> None:
    with pytest.raises(GlbenchError, match=r"number of (workers|threads) is (a whole number|at least 1)"):
        make_kernel(TOMATO, workers=workers, backend="casadi")


def test_a_kernel_without_a_model_is_told_what_it_needs() -> None:
    with pytest.raises(ShapeError, match=r"A kernel steps a model.*TOMATO.*got 900\.0"):
        Kernel(900.0)  # type: ignore[arg-type]


def test_numbers_of_the_wrong_kind_are_told_in_words() -> None:
    with pytest.raises(ShapeError, match="The control step lasts 'long' s"):
        Kernel(TOMATO, "long")  # type: ignore[arg-type]
    with pytest.raises(GlbenchError, match="The number of threads is a whole number; got '2'"):
        Kernel(TOMATO, 900.0, threads="2")  # type: ignore[arg-type]
