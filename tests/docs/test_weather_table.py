"""The classifiers of docs/weather.md: on generated seasons they keep their limits, and they find what there is to find."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest
from numpy.typing import NDArray

from docs import weather_table
from glbench.weather import SeasonGenerator, load_weather
from glbench.weather.comparison import generated_seasons


@pytest.mark.slow
@pytest.mark.parametrize("years", [(2008, 2009, 2010), (2011, 2012)])
@pytest.mark.parametrize("seed", [1, 2])
def test_joined_nights_are_hardly_told_from_others(years: tuple[int, ...], seed: int) -> None:
    generator = SeasonGenerator(load_weather("schiphol"), years)
    seasons = generated_seasons(generator, dt.date(2010, 2, 15), 28, 60, 400, seed)
    figures = weather_table.joined_nights(seasons, seed)
    assert len(figures) == 5
    assert {one.name: one.value for one in figures if not one.within_limits} == {}
    assert figures[-1].value > 0.85, "a classifier that has seen the same nights recognises most of them"


def test_a_measurement_has_the_figures_of_the_page() -> None:
    found = weather_table.measure("short", seasons=40, days=30)
    assert [one.name.replace("30 days", "60 days") for one in found.figures] == [
        one["name"] for one in weather_table.read()["short"]["figures"]
    ]


def _signal(kind: str, rows: int = 1200) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    rng = np.random.default_rng(8)
    x = rng.normal(size=(rows, 6))
    strength = {"line": x[:, 0] + x[:, 1], "product": 4.0 * np.sign(x[:, 0]) * np.sign(x[:, 1]), "none": 0.0 * x[:, 0]}[kind]
    return x, rng.random(rows) < 1.0 / (1.0 + np.exp(-1.5 * strength))


def test_the_classifiers_find_what_they_can_and_nothing_where_nothing_is() -> None:
    for kind, by_line, by_trees in (
        ("line", (0.85, 0.95), (0.8, 0.95)),
        ("product", (0.4, 0.6), (0.9, 1.0)),
        ("none", (0.44, 0.56), (0.44, 0.56)),
    ):
        x, labels = _signal(kind)
        ones, zeros = np.flatnonzero(labels), np.flatnonzero(~labels)
        for classify, (low, high) in ((weather_table.logistic, by_line), (weather_table.boosted, by_trees)):
            found = weather_table.area(classify, x, [ones[ones < 600], ones[ones >= 600]], [zeros[zeros < 600], zeros[zeros >= 600]])
            assert low < found < high, (kind, classify.__name__, found)
