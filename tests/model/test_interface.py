"""What callers rely on: order and names, clear refusals, variants, digests, the start of the season."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest

from glbench.errors import ShapeError, UnknownNameError
from glbench.model import (
    AUXILIARIES,
    BUTTERHEAD,
    COMPARTMENT,
    CONTROL_NAMES,
    CONTROLS,
    DISTURBANCE_NAMES,
    DISTURBANCES,
    HARVESTED_BUTTERHEAD,
    LETTUCE,
    PARAMETER_NAMES,
    STATE_NAMES,
    STATES,
    TOMATO_2,
    TOMATO_ENERGY,
    TOMATO_HEAT_PUMP,
    VARIANTS,
    build_rhs,
    default_parameters,
    initial_state,
    jacobian,
    model_digest,
    rhs,
    saturation_vapour_pressure,
)
from glbench.model.digest import digest_of
from glbench.model.paper import Controls, Disturbances, Parameters, State, greenlight
from glbench.model.variants import AUTHOR, GL_GYM2, Variant
from tests.model.conditions import a_day, reference_points, with_entry

POINTS = reference_points()
ROWS = [field.name for field in fields(Variant) if field.name != "name"]


def test_names_are_in_the_order_of_the_vectors() -> None:
    assert (len(STATE_NAMES), len(CONTROL_NAMES), len(DISTURBANCE_NAMES), len(PARAMETER_NAMES)) == (28, 6, 10, 208)
    assert CONTROL_NAMES == ("uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr")
    assert STATE_NAMES[:3] == ("co2Air", "co2Top", "tAir")
    assert (STATE_NAMES[15], STATE_NAMES[25], STATE_NAMES[27]) == ("vpAir", "cFruit", "time")
    assert (DISTURBANCE_NAMES[0], DISTURBANCE_NAMES[9]) == ("iGlob", "isDaySmooth")
    assert (PARAMETER_NAMES[46], PARAMETER_NAMES[172], PARAMETER_NAMES[207]) == ("aFlr", "thetaLampMax", "eps")


def test_every_name_is_explained_in_the_nomenclature() -> None:
    docs = Path(__file__).parents[2] / "docs"
    pages = ("nomenclature.md", "model-symbols.md", "crop-symbols.md")
    page = "".join((docs / name).read_text(encoding="utf-8") for name in pages)

    models = (LETTUCE, BUTTERHEAD, HARVESTED_BUTTERHEAD, TOMATO_ENERGY, TOMATO_HEAT_PUMP, COMPARTMENT, TOMATO_2)
    others = (entry for model in models for entry in (*model.states, *model.controls, *model.auxiliaries))
    for entry in (*STATES, *CONTROLS, *DISTURBANCES, *AUXILIARIES, *others):
        if re.fullmatch(r"[cn]Fruit([2-9]|\d\d)", entry.name):
            continue  # explained with that of the first stage
        row = next((line for line in page.splitlines() if line.startswith(f"| `{entry.name}` |")), "")
        assert f"| {entry.unit} |" in row, entry.name


@pytest.mark.parametrize(
    ("name", "bad", "message"),
    [
        ("x", np.zeros(27), r"Input x has shape \(27,\); expected \(28,\) or \(n, 28\)"),
        ("u", np.zeros((2, 3, 6)), r"Input u has shape \(2, 3, 6\)"),
        ("d", np.full(10, np.nan), "Input d is not finite: iGlob is nan"),
        ("p", np.zeros(()), r"Input p has shape \(\)"),
        ("x", ["warm"] * 28, "Input x is not an array of numbers"),
    ],
)
def test_inputs_of_another_shape_are_refused(name: str, bad: object, message: str) -> None:
    inputs: dict[str, Any] = {**a_day()._asdict(), name: bad}

    for function in (rhs, jacobian):
        with pytest.raises(ShapeError, match=message):
            function(**inputs)


def test_the_row_and_name_of_a_value_that_is_not_finite_are_told() -> None:
    x, u, d, p = a_day()
    rows = np.stack([x, with_entry(x, STATE_NAMES, tPipe=np.inf)])

    with pytest.raises(ShapeError, match="tPipe of row 1 is inf"):
        rhs(rows, u, d, p)


def test_batches_of_different_size_are_refused() -> None:
    x, u, d, p = a_day()

    with pytest.raises(ShapeError, match="x has 2, u has 3"):
        rhs(np.tile(x, (2, 1)), np.tile(u, (3, 1)), d, p)


def test_unknown_variants_inputs_and_symbols_are_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="'gl_gym2'"):
        rhs(*a_day(), variant="gl_gym")
    with pytest.raises(UnknownNameError, match=r"no input 'v'\. Known: x, u, d, p"):
        jacobian(*a_day(), wrt="v")
    with pytest.raises(UnknownNameError, match="Known: SX, MX"):
        build_rhs("author", "XX")


def test_the_function_for_code_generation_has_named_inputs() -> None:
    function = build_rhs()

    assert function.name() == "rhs"
    assert [function.name_in(k) for k in range(4)] == ["x", "u", "d", "p"]
    assert function.name_out(0) == "dxdt"
    assert function.is_a("SXFunction")
    assert function is build_rhs()


@pytest.mark.parametrize(
    ("row", "states"),
    [
        ("leaf_pruning_rate", {"cLeaf"}),
        ("blackout_screen_dries", {"tBlScr", "vpAir"}),
        ("vapour_flow_factor", {"vpAir", "vpTop"}),
        ("vapour_flow_celsius_zero", {"vpAir", "vpTop"}),
        ("harvest_logarithm", {"cLeaf", "cFruit"}),
        ("screen_flow_guard", {"co2Air", "co2Top", "tAir", "tTop", "vpAir", "vpTop"}),
        ("electron_transport_guard", {"co2Air", "cBuf"}),
        ("blackout_screen_hides_sky_from_pipe", {"tPipe"}),
        ("side_vents_counted", {"co2Air", "co2Top", "tAir", "tTop", "vpAir", "vpTop"}),
    ],
)
def test_a_deviation_of_the_published_code_changes_its_states_only(row: str, states: set[str]) -> None:
    changed = replace(AUTHOR, **{row: getattr(GL_GYM2, row)})
    x, u, d, p = (rows.T for rows in POINTS.inputs)
    before, after = (
        greenlight(State(*x), Controls(*u), Disturbances(*d), Parameters(*p), variant).derivative for variant in (AUTHOR, changed)
    )

    assert {name for name, one, other in zip(STATE_NAMES, before, after, strict=True) if np.any(one != other)} == states


def test_the_published_code_is_the_author_s_model_with_eleven_deviations() -> None:
    assert len(ROWS) == 11
    assert all(getattr(AUTHOR, row) != getattr(GL_GYM2, row) for row in ROWS)
    assert VARIANTS == ("author", "gl_gym2")


def digest_with(variant: Variant) -> str:
    vectors = [casadi.SX.sym(name, n) for name, n in zip("xudp", (28, 6, 10, 208), strict=True)]
    x, u, d, p = (casadi.vertsplit(vector) for vector in vectors)
    derivative = greenlight(State(*x), Controls(*u), Disturbances(*d), Parameters(*p), variant).derivative
    return digest_of(casadi.Function("f", vectors, [casadi.vertcat(*derivative)]))


def test_the_digest_names_the_equations_and_nothing_else() -> None:
    # Built anew, without sharing of common expressions and under another name.
    assert digest_with(AUTHOR) == model_digest() == model_digest("author")
    assert digest_with(GL_GYM2) == model_digest("gl_gym2")


def test_every_deviation_changes_the_digest() -> None:
    digests = {digest_with(replace(AUTHOR, **{row: getattr(GL_GYM2, row)})) for row in ROWS}

    assert len(digests | {model_digest("author"), model_digest("gl_gym2")}) == len(ROWS) + 2


def test_the_last_bit_of_a_constant_changes_the_digest() -> None:
    z = casadi.SX.sym("z", 2)

    def digest(constant: float, order: int = 1) -> str:
        outputs = [z[0] * constant + casadi.exp(z[1]), z[1]][::order]
        return digest_of(casadi.Function("f", [z], [casadi.vertcat(*outputs)]))

    assert digest(0.1) == digest(0.1)
    assert len({digest(0.1), digest(np.nextafter(0.1, 1)), digest(0.1, -1)}) == 3


def test_the_digest_is_the_same_in_another_process() -> None:
    command = "from glbench.model import model_digest; print(model_digest('gl_gym2'), model_digest())"
    other = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True, env={"PYTHONHASHSEED": "7", "PATH": ""}
    )

    assert other.stdout.split() == [model_digest("gl_gym2"), model_digest("author")]


def test_the_season_starts_with_a_mature_crop() -> None:
    d = POINTS.of("initial_state").d[0]
    outside = dict(zip(DISTURBANCE_NAMES, d.tolist(), strict=True))

    state = dict(zip(STATE_NAMES, initial_state(d).tolist(), strict=True))

    assert state["co2Air"] == state["co2Top"] == outside["co2Out"]
    assert state["tAir"] == state["tPipe"] == state["tSo1"] == 16.5
    assert state["tCan"] == state["tCan24"] == 20.5
    assert state["tSo3"] == pytest.approx((16.5 + outside["tSoOut"]) / 2)
    assert state["tSo5"] == outside["tSoOut"]
    assert state["vpAir"] == state["vpTop"] == 0.9 * saturation_vapour_pressure(16.5) == pytest.approx(1681.90975, abs=1e-5)
    assert (state["cBuf"], state["cLeaf"], state["cStem"], state["cFruit"]) == (0, 95283, 251070, 55338)
    assert (state["tCanSum"], state["time"]) == (3097.8, 0)


def test_the_start_equals_that_of_the_reference_points_but_for_the_clock() -> None:
    x, _, d, p = POINTS.of("initial_state")

    np.testing.assert_array_equal(initial_state(d[0], parameters=p[0])[:-1], x[0][:-1])


def test_another_cultivar_starts_with_the_same_leaf_area() -> None:
    d = POINTS.of("initial_state").d[0]
    thin_leaves = default_parameters(overrides={"sla": 3.325e-5})

    leaves = [initial_state(d, parameters=p)[STATE_NAMES.index("cLeaf")] for p in (default_parameters(), thin_leaves)]

    assert leaves == pytest.approx([95283.0, 95283.0 / 1.25], rel=1e-15)


@pytest.mark.parametrize("row", [np.zeros(9), np.full(10, np.nan), np.zeros((2, 10))])
def test_the_start_needs_one_finite_row_of_weather(row: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    with pytest.raises(ShapeError, match="one finite row of 10 disturbances"):
        initial_state(row)


def test_the_start_refuses_parameters_of_another_model() -> None:
    with pytest.raises(ShapeError, match=r"208 nominal parameters; got shape \(3,\)"):
        initial_state(POINTS.of("day").d[0], parameters=np.zeros(3))
