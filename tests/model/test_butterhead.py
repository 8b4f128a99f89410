"""Butterhead lettuce: price by weight class against a second implementation, registration, and growth as in van Henten's lettuce."""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from glbench.model import BUTTERHEAD, LETTUCE, Horizon
from glbench.model.crop.butterhead import FIFTHS, relative_price
from glbench.model.crop.lettuce import start_state
from tests.model.conditions import reference_points

POINTS = reference_points()
P = BUTTERHEAD.parameters.default()
WEATHER = POINTS.inputs.d[0]


def price_of_a_head(mass: float) -> float:
    """The classes of a hundred heads [kg] once more, with branches."""
    classes = [(18, 0.0), (22, 0.39), (25, 0.46), (28, 0.54), (31, 0.62), (34, 0.70), (37, 0.79), (40, 0.88), (44, 1.0), (50, 1.1)]
    if mass <= 180:
        return 0.0
    for (light, least), (heavy, most) in pairwise(classes):
        if mass <= 10 * heavy:
            return least + (most - least) * (mass - 10 * light) / (10 * heavy - 10 * light)
    return 1.1


def priced(head: float, **changed: float) -> float:
    """Heads that count [m-2] in a crop whose heads weigh ``head`` [g] on average."""
    p = BUTTERHEAD.Parameters(*P)._replace(**changed)
    start = start_state(p, head)
    record = BUTTERHEAD.State(*np.zeros(len(BUTTERHEAD.states)))._replace(x_n=start.x_n, x_s=start.x_s)
    (stock,) = (stock for stock in BUTTERHEAD.stocks() if stock.name == "priced_heads")
    return float(stock.amount(record, p))


def planted(head: float, model: Any = BUTTERHEAD) -> Any:
    """State of plants of ``head`` [g] each."""
    state = model.start("young_lettuce", WEATHER, 18.0, model.parameters.default()).copy()
    own = start_state(model.Parameters(*model.parameters.default()), head)
    state[model.state_index("xN")], state[model.state_index("xS")] = own
    return state


@pytest.mark.parametrize("head", [0.0, 179.0, 180.0, 200.0, 220.0, 265.0, 300.0, 370.0, 405.0, 440.0, 499.0, 500.0, 900.0])
def test_a_head_earns_what_its_class_earns(head: float) -> None:
    assert float(relative_price(head)) == pytest.approx(price_of_a_head(head), abs=1e-12)
    assert priced(head, cv_head=0.0) == pytest.approx(25 * price_of_a_head(head), abs=1e-12)


@pytest.mark.parametrize("head", [100.0, 180.0, 230.0, 310.0, 420.0, 480.0, 600.0])
def test_a_planting_earns_about_the_mean_over_heads_that_differ(head: float) -> None:
    """Five groups stand for the normal distribution."""
    sd = 0.15 * head
    density = lambda mass: math.exp(-0.5 * ((mass - head) / sd) ** 2) / (sd * math.sqrt(2 * math.pi))  # noqa: E731
    exact, _ = quad(lambda mass: price_of_a_head(mass) * density(mass), head - 6 * sd, head + 6 * sd, limit=200)
    assert priced(head) / 25 == pytest.approx(exact, abs=0.015)


def test_each_group_is_a_fifth_of_a_normal_distribution() -> None:
    edges = [-math.inf, *(NormalDist().inv_cdf(k / 5) for k in range(1, 5)), math.inf]
    density = lambda z: math.exp(-z * z / 2) / math.sqrt(2 * math.pi)  # noqa: E731
    means = [5 * (density(low) - density(high)) for low, high in pairwise(edges)]
    assert pytest.approx(means, abs=5e-4) == FIFTHS


def test_heavier_heads_earn_more_from_150_to_600_g_without_a_plateau() -> None:
    earned = [priced(head) for head in range(150, 600, 5)]
    assert (np.diff(earned) > 0).all()
    assert priced(120.0) == 0.0


def test_the_heaviest_class_is_the_dearest_and_the_known_ratio_is_kept() -> None:
    """At BelOrta on 12 December 2018 a 37 fetched 0.64 EUR and a 44 0.81 EUR."""
    assert price_of_a_head(370) == pytest.approx(0.64 / 0.81, abs=0.005)
    for mass in (220.0, 250.0, 280.0, 310.0, 340.0, 400.0):
        power = (mass / 440) ** (math.log(0.81 / 0.64) / math.log(44 / 37))
        assert price_of_a_head(mass) == pytest.approx(power, abs=0.01)


def test_it_grows_as_van_hentens_lettuce_does() -> None:
    u = np.full(6, 0.3)
    for head in (3.0, 60.0, 300.0):
        own, known = (model.rhs(planted(head, model), u, WEATHER, model.parameters.default()) for model in (BUTTERHEAD, LETTUCE))
        assert own.tobytes() == known.tobytes()


def test_what_is_registered_is_the_mass_of_a_head_and_nothing_else() -> None:
    horizon = Horizon(38 * 96, 900.0, dict(zip(BUTTERHEAD.parameter_names, P.tolist(), strict=True)))
    (column,) = BUTTERHEAD.observed("registration", horizon) or ()
    assert (column.name, column.unit) == ("mean_head_mass", "g")
    assert column.of is not None
    for head in (3.0, 250.0):
        assert float(column.of(BUTTERHEAD.State(*planted(head)), BUTTERHEAD.Parameters(*P))) == pytest.approx(head)
