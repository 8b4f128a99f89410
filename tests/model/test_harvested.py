"""Lettuce that a crew cuts: growth as without a crew, cutting, what is sold, what young plants cost, what standing plants are worth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glbench.kernel import Kernel
from glbench.model import BUTTERHEAD, HARVESTED_BUTTERHEAD, Horizon, Step
from glbench.model.crop.butterhead import FIFTHS
from glbench.model.crop.harvested import SIZES, STANDING
from glbench.model.crop.lettuce import head_mass, start_state
from tests.model.conditions import reference_points

MODEL = HARVESTED_BUTTERHEAD
P = MODEL.parameters.default()
RECORD = MODEL.Parameters(*P)
WEATHER = reference_points().inputs.d[0]
CREW = MODEL.control_names.index("uHarvest")
FLOWS = {flow.name: flow for flow in MODEL.flows()}
STEP = 900.0


def planted(head: float, days: float = 30.0, model: Any = MODEL) -> Any:
    """State of plants of ``head`` [g] each, some days after planting."""
    state = model.start("young_lettuce", WEATHER, 18.0, model.parameters.default()).copy()
    own = start_state(RECORD, head)
    state[model.state_index("xN")], state[model.state_index("xS")] = own
    if model is MODEL:
        state[MODEL.state_index("plantingDays")] = days
    return state


def controls(crew: float) -> Any:
    u = np.full(len(MODEL.controls), 0.3)
    u[CREW] = crew
    return u


def of_step(flow: str, head: float, crew: float, days: float = 30.0) -> float:
    before = MODEL.State(*planted(head, days))
    return float(FLOWS[flow].amount(Step(before, before, MODEL.Controls(*controls(crew)), RECORD, STEP)))


def test_without_a_crew_it_grows_as_butterhead_does() -> None:
    for head in (3.0, 60.0, 300.0):
        own = dict(zip(MODEL.state_names, MODEL.rhs(planted(head), controls(0.0), WEATHER, P), strict=True))
        known = BUTTERHEAD.rhs(planted(head, model=BUTTERHEAD), np.full(6, 0.3), WEATHER, BUTTERHEAD.parameters.default())
        assert {name: own[name] for name in BUTTERHEAD.state_names} == dict(zip(BUTTERHEAD.state_names, known, strict=True))
        assert own["plantingDays"] == pytest.approx(1 / 86400)


@pytest.mark.parametrize("preset", ["fast", "reference"])
def test_a_crew_leaves_young_plants_within_a_step(preset: str) -> None:
    kernel = Kernel(MODEL, STEP, preset=preset)
    after = kernel.step(planted(400.0), controls(1.0), WEATHER, P)
    assert head_mass(MODEL.State(*after), RECORD) == pytest.approx(3.0, abs=0.02)
    assert after[MODEL.state_index("plantingDays")] == pytest.approx(60 / 86400, abs=1e-3)
    for _ in range(5):
        after = kernel.step(after, controls(1.0), WEATHER, P)
    assert head_mass(MODEL.State(*after), RECORD) == pytest.approx(3.0, abs=0.02)
    grown = kernel.step(after, controls(0.0), WEATHER, P)
    assert grown[MODEL.state_index("plantingDays")] == pytest.approx((60 + STEP) / 86400, abs=1e-5)


def test_later_plants_begin_with_the_mass_that_the_nursery_delivers() -> None:
    p = P.copy()
    p[MODEL.parameter_names.index("youngHead")] = 5.0
    after = Kernel(MODEL, STEP).step(planted(400.0), controls(1.0), WEATHER, p)
    assert head_mass(MODEL.State(*after), RECORD) == pytest.approx(5.0, abs=0.02)


@pytest.mark.parametrize(
    ("head", "relative"), [(150.0, 0.0), (200.0, 0.0), (270.0, 0.5), (310.0, 1.0), (400.0, 1.0), (450.0, 0.8), (900.0, 0.2)]
)
def test_a_head_earns_what_its_size_earns(head: float, relative: float) -> None:
    alike = RECORD._replace(cv_head=0.0)
    before = MODEL.State(*planted(head))
    cut = FLOWS["heads_cut"].amount(Step(before, before, MODEL.Controls(*controls(1.0)), alike, STEP))
    assert float(cut) == pytest.approx(25.0 * relative, rel=1e-6, abs=1e-9)


def test_a_planting_earns_the_mean_over_heads_that_differ_and_nothing_without_a_crew() -> None:
    for head in (180.0, 300.0, 370.0, 440.0, 700.0):
        mean = np.mean([np.interp(head * (1 + 0.15 * z), list(SIZES), list(SIZES.values())) for z in FIFTHS])
        assert of_step("heads_cut", head, 1.0) == pytest.approx(25.0 * mean, rel=1e-6)
        assert of_step("heads_cut", head, 0.0) == 0.0
    half = of_step("heads_cut", 370.0, 0.01) / of_step("heads_cut", 370.0, 1.0)
    assert half == pytest.approx(1 - np.exp(-0.15), rel=1e-6), "who cuts a part sells that part"


def test_young_plants_are_paid_once_a_harvest() -> None:
    assert of_step("plants_set", 370.0, 1.0) == pytest.approx(25.0, rel=1e-6)
    assert of_step("plants_set", 3.0, 1.0, days=60 / 86400) < 0.02
    assert of_step("plants_set", 370.0, 0.0) == 0.0


def test_no_plant_is_worth_more_left_than_cut_once_it_is_ready_and_young_ones_are_worth_their_price() -> None:
    (stock,) = (stock for stock in MODEL.stocks() if stock.name == "standing_heads")
    worth = [float(stock.amount(MODEL.State(*planted(head)), RECORD)) for head in range(3, 800)]
    assert worth[0] == pytest.approx(25 * 0.12, rel=1e-6)
    assert max(worth) == pytest.approx(25 * 0.9, rel=1e-3)
    alike = RECORD._replace(cv_head=0.10)
    for head in range(335, 500, 5):
        before = MODEL.State(*planted(float(head)))
        cut = FLOWS["heads_cut"].amount(Step(before, before, MODEL.Controls(*controls(1.0)), alike, STEP))
        assert float(cut) > worth[head - 3]
    assert list(STANDING) == sorted(STANDING)


def test_what_is_observed_of_a_planting() -> None:
    horizon = Horizon(77 * 96, STEP, dict(zip(MODEL.parameter_names, P.tolist(), strict=True)))
    (column,) = MODEL.observed("planting", horizon) or ()
    assert (column.name, column.unit, column.source) == ("days_since_planting", "day", "plantingDays")
    assert (MODEL.observed("registration", horizon) or ())[0].name == "mean_head_mass"
    assert np.isfinite(MODEL.jacobian(planted(300.0), controls(1.0), WEATHER, P)).all()
