"""The page of statistics: it accepts the generator, and refuses worse ones."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.weather import Blocks, SeasonGenerator, WeatherRecord, load_weather
from glbench.weather.comparison import Figure, Resemblance, generated_seasons, midnight_changes, real_seasons, resemblance

TRAINING, TEST = (2008, 2009, 2010), (2011, 2012)


@pytest.fixture(scope="module")
def schiphol() -> WeatherRecord:
    return load_weather("schiphol")


def missed(found: Resemblance) -> list[str]:
    return [f"{figure.name}: {figure.value:.3f} ({figure.limits}) {figure.worst}" for figure in found.figures if not figure.within_limits]


def value(found: Resemblance, words: str) -> float:
    (figure,) = (figure for figure in found.figures if figure.name.startswith(words))
    return figure.value


@pytest.mark.slow
@pytest.mark.parametrize("years", [TRAINING, TEST])
@pytest.mark.parametrize("seed", [1, 2])
def test_generated_seasons_resemble_the_years_they_are_made_of(schiphol: WeatherRecord, years: tuple[int, ...], seed: int) -> None:
    found = resemblance(SeasonGenerator(schiphol, years), seasons=400, seed=seed)
    assert {figure.name for figure in found.figures if not figure.within_limits} <= {
        f"size of changes at joints, {name}, Kolmogorov-Smirnov distance [-]" for name in ("relative humidity", "wind speed")
    }, missed(found)


def test_a_few_seasons_resemble_the_training_years(schiphol: WeatherRecord) -> None:
    found = resemblance(SeasonGenerator(schiphol, TRAINING), seasons=116)
    assert value(found, "bias") < 0.1
    assert value(found, "smallest ratio") > 0.93
    assert value(found, "largest ratio") < 1.07
    assert value(found, "autocorrelation") < 0.15
    assert value(found, "changes at joints") < 0.10
    assert value(found, "radiation sum of 60 days, generated") == pytest.approx(1.0, abs=0.03)
    assert 15.0 < value(found, "days that two seasons share") < 40.0
    assert value(found, "the same at the same place") < 3.0


def test_rounding_at_joints_makes_small_changes_vanish_which_signs_hide(schiphol: WeatherRecord) -> None:
    generator = SeasonGenerator(schiphol, TRAINING)
    found = resemblance(generator, seasons=116)
    assert value(found, "size of changes at joints, wind speed") > 1.3 * value(found, "changes at joints")
    made, real = (generated_seasons(generator, dt.date(2010, 2, 15), 28, 60, 116, 1), real_seasons(generator, dt.date(2010, 2, 15), 28, 60))
    joined = made.joints[:, 1:]
    calm = [(change == 0.0).mean() for change in (midnight_changes(made)["wind_speed"][joined], midnight_changes(real)["wind_speed"])]
    numbers, values = generator.real_days()
    begins = np.searchsorted(numbers, made.sources[:, 1:][joined])
    begins = begins[(begins > 0) & (numbers[begins - 1] == numbers[begins] - 1)]
    truly = (values["wind_speed"][begins, 0] == values["wind_speed"][begins - 1, -1]).mean()
    assert calm[0] > calm[1] + 0.06
    assert truly == pytest.approx(calm[1], abs=0.04), "the blocks that were chosen began as any night"


def test_days_in_random_order_are_refused(schiphol: WeatherRecord) -> None:
    shuffled = Blocks(shortest=1, longest=1, nearest=60, rest=1, midnight=(0.0,) * 4, day=(0.0,) * 5, days=(0.0,) * 5)
    found = resemblance(SeasonGenerator(schiphol, TRAINING, shuffled), seasons=58)
    assert not found.accepted
    assert value(found, "autocorrelation") > 0.25  # and 0.15 is the limit


def test_the_figures_belong_to_their_arguments(schiphol: WeatherRecord) -> None:
    generator = SeasonGenerator(schiphol, TRAINING)
    arguments = {"start": dt.date(2010, 10, 1), "within_days": 3, "days": 30, "seasons": 40}
    one = resemblance(generator, **arguments, seed=5)  # type: ignore[arg-type]
    assert one == resemblance(generator, **arguments, seed=5)  # type: ignore[arg-type]
    assert one.figures != resemblance(generator, **arguments, seed=6).figures  # type: ignore[arg-type]
    assert (one.start, one.days, one.years, one.digest) == ("10-01", 30, TRAINING, schiphol.digest)
    # Degree-hours of a month of autumn, by the record itself: the ratio is to the real ones.
    assert value(one, "degree-hours of 30 days, generated over real") == pytest.approx(1.0, abs=0.1)


def test_what_cannot_be_compared_is_refused(schiphol: WeatherRecord) -> None:
    generator = SeasonGenerator(schiphol, (2009,))
    with pytest.raises(WeatherError, match="at least 20 seasons"):
        resemblance(generator, seasons=19)
    with pytest.raises(WeatherError, match="None of the years 2009 holds 60 days in a row from 15 December"):
        resemblance(generator, start=dt.date(2010, 12, 15), within_days=0, seasons=20)


def test_a_figure_knows_its_limits() -> None:
    assert Figure("a", 0.1, None, 0.1).within_limits
    assert not Figure("a", 0.11, None, 0.1).within_limits
    assert not Figure("a", 0.9, 0.93, 1.07).within_limits
    assert Figure("a", 99.0).within_limits
    assert [Figure("a", 1.0, *limits).limits for limits in ((None, 0.1), (0.93, 1.07), (None, None))] == ["at most 0.1", "0.93 to 1.07", ""]
