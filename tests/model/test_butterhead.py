"""Butterhead lettuce: price by weight class against a second implementation, samples, and growth as in van Henten's lettuce."""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from glbench.kernel import Kernel
from glbench.model import BUTTERHEAD, LETTUCE, Horizon
from glbench.model.crop.butterhead import FIFTHS, relative_price
from glbench.model.crop.lettuce import start_state
from tests.model.conditions import reference_points

POINTS = reference_points()
P = BUTTERHEAD.parameters.default()
WEATHER = POINTS.inputs.d[0]
WEIGH = BUTTERHEAD.control_names.index("uWeigh")
SAMPLE, AGE = (BUTTERHEAD.state_index(name) for name in ("sampleMass", "sampleAge"))


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


def test_a_sample_is_weighed_within_a_step_and_kept_until_the_next() -> None:
    kernel, u = Kernel(BUTTERHEAD, 900.0), np.full(7, 0.2)
    heavier = BUTTERHEAD.parameters.default(overrides={"sampleShare": 1.08})
    state = planted(150.0)
    state[SAMPLE] = 90.0

    u[WEIGH] = 0.0
    unseen = kernel.step(state, u, WEATHER, heavier)
    u[WEIGH] = 1.0
    weighed = kernel.step(unseen, u, WEATHER, heavier)
    u[WEIGH] = 0.0
    later = weighed
    for _ in range(4):
        later = kernel.step(later, u, WEATHER, heavier)

    head = next(signal for signal in BUTTERHEAD.signals() if signal.path == "crop/head").of
    assert head is not None
    mass = head(BUTTERHEAD.State(*weighed), BUTTERHEAD.Parameters(*heavier))
    assert unseen[SAMPLE] == pytest.approx(90.0, abs=1e-9)
    assert unseen[AGE] == pytest.approx(1 / 96, rel=1e-6)
    assert weighed[SAMPLE] == pytest.approx(1.08 * mass, rel=1e-3)
    assert weighed[AGE] < 2e-3
    assert later[SAMPLE] == pytest.approx(weighed[SAMPLE], abs=1e-9)
    assert later[AGE] - weighed[AGE] == pytest.approx(4 / 96, rel=1e-6)


def test_it_grows_as_van_hentens_lettuce_does() -> None:
    u = np.full(6, 0.3)
    for head in (3.0, 60.0, 300.0):
        before, with_sample = planted(head, LETTUCE), planted(head)
        rates = dict(zip(LETTUCE.state_names, LETTUCE.rhs(before, u, WEATHER, LETTUCE.parameters.default()), strict=True))
        own = dict(zip(BUTTERHEAD.state_names, BUTTERHEAD.rhs(with_sample, np.append(u, 0.0), WEATHER, P), strict=True))
        assert {name: own[name] for name in rates} == rates
        assert (own["sampleMass"], own["sampleAge"]) == (0.0, 1 / 86400)


def test_what_is_registered_is_the_sample_and_nothing_else() -> None:
    horizon = Horizon(38 * 96, 900.0, dict(zip(BUTTERHEAD.parameter_names, P.tolist(), strict=True)))
    columns = BUTTERHEAD.observed("registration", horizon) or ()
    assert [(column.name, column.unit, column.source) for column in columns] == [
        ("sample_mass", "g", "sampleMass"), ("sample_age", "day", "sampleAge"),
    ]  # fmt: skip
    start = dict(zip(BUTTERHEAD.state_names, BUTTERHEAD.start("young_lettuce", WEATHER, 18.0, P), strict=True))
    assert (start["sampleMass"], start["sampleAge"]) == (pytest.approx(3.0), 0.0)
