"""The generated code's own exp, log, pow, tanh and cos against 40-digit arithmetic."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from decimal import Decimal, localcontext
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel.compiled import library
from glbench.kernel.compiled.compiler import find_compiler

Array: TypeAlias = NDArray[np.float64]
Probe: TypeAlias = Callable[[str, Array, Array], Array]
NAMES = ("exp", "log", "pow", "pow_positive", "tanh", "cos", "exp16", "pow16")
POINTS = 4000


@pytest.fixture(scope="module")
def probe(compiled: None, tmp_path_factory: pytest.TempPathFactory) -> Probe:
    """Calls a function with one lane and with the widest vectors, and asserts that the bits agree."""
    path = tmp_path_factory.mktemp("probe") / "probe.so"
    compiler = find_compiler()
    native = Path(library.__file__).parent / "native"
    compiler.compile(Path(__file__).parent / "math_probe.cpp", path, (native,), compiler.flags())
    function = ctypes.CDLL(str(path)).probe

    def call(name: str, a: Array, b: Array) -> Array:
        a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
        results = [np.empty_like(a), np.empty_like(a)]
        pointer = ctypes.POINTER(ctypes.c_double)
        for wide, result in enumerate(results):
            arrays = (array.ctypes.data_as(pointer) for array in (a, b, result))
            function(ctypes.c_int(wide), ctypes.c_int(NAMES.index(name)), *arrays, ctypes.c_int64(len(a)))
        assert results[0].tobytes() == results[1].tobytes()
        return results[0]

    return call


def ulps(found: Array, exact: list[Decimal]) -> float:
    """Largest error in units of the last place of the exact value."""
    return max(float(abs(Decimal(value) - truth)) / math.ulp(float(truth)) for value, truth in zip(found.tolist(), exact, strict=True))


def test_exp16_is_within_about_one_unit_of_the_last_place(probe: Probe) -> None:
    generator = np.random.default_rng(0)
    t = np.concatenate([generator.uniform(-15_900.0, 16_300.0, POINTS), generator.uniform(-40.0, 40.0, POINTS)])
    with localcontext(prec=40):
        sixteenth = Decimal(2).ln() / 16
        exact = [(Decimal(v) * sixteenth).exp() for v in t.tolist()]
    assert ulps(probe("exp16", t, t), exact) < 1.1


@pytest.mark.parametrize("largest", [1.0, 20.0, 700.0])
def test_exp_is_as_good_as_the_product_in_its_argument(probe: Probe, largest: float) -> None:
    x = np.random.default_rng(0).uniform(-min(largest, 690.0), largest, POINTS)
    with localcontext(prec=40):
        exact = [Decimal(v).exp() for v in x.tolist()]
    assert ulps(probe("exp", x, x), exact) < 1.6 + 1.2 * largest


def test_exp_saturates_and_passes_on_what_is_not_a_number(probe: Probe) -> None:
    found = probe("exp", np.array([-1e9, -708.0, 710.0, 1e9, np.inf, -np.inf, np.nan, 0.0]), np.zeros(8))
    assert found[0] == found[1] == found[5] > 0.0
    assert found[2] == found[3] == found[4] < np.inf
    assert math.isnan(found[6])
    assert found[7] == 1.0


def test_log_is_within_two_units_of_the_last_place(probe: Probe) -> None:
    generator = np.random.default_rng(1)
    x = np.concatenate([10.0 ** generator.uniform(-300.0, 300.0, POINTS), generator.uniform(0.5, 2.0, POINTS)])
    with localcontext(prec=40):
        exact = [Decimal(v).ln() for v in x.tolist()]
    assert ulps(probe("log", x, x), exact) < 2.0


def test_log_of_zero_and_below(probe: Probe) -> None:
    found = probe("log", np.array([0.0, -1.0, np.nan, 1.0, 2.0, 1.0, 1.0, 1.0]), np.zeros(8))
    assert found[0] == -np.inf
    assert np.isnan(found[1:3]).all()
    assert found[3] == 0.0


@pytest.mark.parametrize("exponent", [0.165, 0.32, 0.5, 1.0 / 6.0, -0.125, 0.89])
@pytest.mark.parametrize("decades", [0.3, 2.0, 14.0])
def test_powers_lose_no_more_than_the_rounding_of_the_logarithm(probe: Probe, exponent: float, decades: float) -> None:
    x = 10.0 ** np.random.default_rng(2).uniform(-decades, decades, POINTS)
    y = np.full_like(x, exponent)
    with localcontext(prec=40):
        exact = [(Decimal(exponent) * Decimal(v).ln()).exp() for v in x.tolist()]
    for found in (probe("pow", x, y), probe("pow_positive", x, y), probe("pow16", x, 16.0 * y)):
        assert ulps(found, exact) < 1.5 + 1.5 * abs(exponent) * decades * math.log2(10.0)


def test_squares_by_powers(probe: Probe) -> None:
    x = 10.0 ** np.random.default_rng(2).uniform(-14.0, 6.0, POINTS)
    np.testing.assert_allclose(probe("pow", x, np.full_like(x, 2.0)), x * x, rtol=2e-14)


def test_powers_of_zero_and_below(probe: Probe) -> None:
    x = np.array([0.0, 5e-324, -1.0, np.nan, 1.0, 1.0, 1.0, 1.0])
    found = probe("pow", x, np.full(8, 0.33))
    assert found[0] == found[1] == 0.0
    assert np.isnan(found[2:4]).all()
    assert (found[4:] == 1.0).all()


def test_tanh_is_within_three_units_of_the_last_place(probe: Probe) -> None:
    generator = np.random.default_rng(3)
    x = np.concatenate([generator.uniform(-25.0, 25.0, POINTS), 10.0 ** generator.uniform(-12.0, 0.0, POINTS)])
    with localcontext(prec=40):
        twice = [(2 * Decimal(v)).exp() for v in x.tolist()]
        exact = [(e - 1) / (e + 1) for e in twice]
    found = probe("tanh", x, x)
    assert ulps(found, exact) < 3.0
    assert (np.abs(found) <= 1.0).all()


def test_cos_agrees_with_the_library(probe: Probe) -> None:
    x = np.random.default_rng(4).uniform(-100.0, 100.0, 2 * POINTS)
    np.testing.assert_allclose(probe("cos", x, x), np.cos(x), rtol=0.0, atol=4e-16)
