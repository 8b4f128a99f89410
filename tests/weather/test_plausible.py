"""Whether a record's radiation fits the sun over its station, and the figures after an import."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from glbench.weather import WeatherRecord, load_weather
from glbench.weather.summary import doubts, in_figures

SHIPPED = ("schiphol", "greensboro", "sand_point", "miami")


@cache
def part(name: str, first_day: int, days: int) -> WeatherRecord:
    record = load_weather(name)
    first, last = 24 * first_day, 24 * (first_day + days)
    counts = {column: values[first:last] for column, values in record.counts.items()}
    return replace(record, begin=record.begin + 3600 * first, counts=counts)


def moved(record: WeatherRecord, hours: int) -> WeatherRecord:
    """The record with every stamp that many hours late."""
    return replace(record, begin=record.begin + 3600 * hours)


def brighter(record: WeatherRecord, factor: float) -> WeatherRecord:
    radiation = np.rint(record.counts["global_radiation"] * factor).astype(np.int64)
    return replace(record, counts={**record.counts, "global_radiation": radiation})


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("days", [2, 10, 30, 300])
@pytest.mark.parametrize("first", [0, 60, 62])
def test_nothing_is_said_about_shipped_records(name: str, first: int, days: int) -> None:
    assert doubts(part(name, first, days)) == []


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize(("days", "hours"), [(3, 5), (3, -5), (40, 1), (40, -1), (40, 2)])
def test_a_clock_that_is_wrong_is_doubted(name: str, days: int, hours: int) -> None:
    (doubt,) = doubts(moved(part(name, 60, days), hours))
    assert "local time instead of UTC" in doubt
    if days == 40:
        assert f"{abs(hours)} h {'late' if hours > 0 else 'early'}" in doubt
    else:
        assert "sun at night in" in doubt


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("days", [10, 300])
def test_radiation_in_another_unit_is_doubted(name: str, days: int) -> None:
    record = part(name, 120, days)
    assert doubts(record) == []
    assert "radiation is low" in doubts(brighter(record, 0.36))[0]
    assert "radiation is high" in doubts(brighter(record, 1 / 0.36))[0]


def test_the_figures_of_a_record_are_those_of_its_values() -> None:
    record = load_weather("schiphol")
    temperature, light, wind = in_figures(record)
    values = record.values("air_temperature")
    assert f"lowest {values.min():.1f} degC, mean {values.mean():.1f} degC, highest {values.max():.1f} degC" in temperature
    a_day = record.values("global_radiation").mean() * 86400
    assert f"{a_day / 1e4:.0f} J/cm2" in light
    assert f"{a_day * 2.3e-6:.1f} mol/m2" in light
    assert f"mean {record.values('wind_speed').mean():.1f} m/s" in wind
