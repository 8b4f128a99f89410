"""Generated seasons: what they are made of, how blocks are joined, and that nothing of another year enters."""

from __future__ import annotations

import datetime as dt
import subprocess
import sys
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from numpy.typing import NDArray
from pvlib.solarposition import declination_spencer71, equation_of_time_spencer71

from glbench.errors import WeatherError
from glbench.weather import Blocks, GeneratedSeason, SeasonGenerator, WeatherRecord, disturbances, load_weather
from glbench.weather.generator import MARGIN_DAYS, RAMP_HOURS, calendar_days, clear_sky, spencer_1971
from glbench.weather.record import QUANTITIES

TRAINING, TEST = (2008, 2009, 2010), (2011, 2012)
SPRING = dt.date(2010, 3, 1)
DIGEST = "00c74007fe09a5c2a1b1fb51ea581b46bd6729b5647fa35bbf9863754f7ed149"


@pytest.fixture(scope="module")
def schiphol() -> WeatherRecord:
    return load_weather("schiphol")


@pytest.fixture(scope="module")
def generator(schiphol: WeatherRecord) -> SeasonGenerator:
    return SeasonGenerator(schiphol, TRAINING)


def made(generator: SeasonGenerator, seed: int, start: dt.date = SPRING, days: int = 60) -> GeneratedSeason:
    return generator.season(start, days, np.random.default_rng(seed).random(generator.numbers(days)))


def some(generator: SeasonGenerator, number: int = 20) -> list[GeneratedSeason]:
    return [made(generator, seed) for seed in range(number)]


def days_of(record: WeatherRecord, name: str) -> NDArray[np.int64]:
    return record.counts[name].reshape(-1, 24)


def source_days(schiphol: WeatherRecord, season: GeneratedSeason, name: str) -> NDArray[np.int64]:
    first = np.datetime64("2008-01-01", "D").astype(np.int64)
    return days_of(schiphol, name)[season.sources - first]


def blocks_of(season: GeneratedSeason) -> list[NDArray[np.int64]]:
    return np.split(season.sources, np.flatnonzero(season.joints))


def test_the_same_numbers_give_the_same_season_to_the_last_bit(generator: SeasonGenerator) -> None:
    one, other = made(generator, 1), made(generator, 1)
    assert one.record.digest == other.record.digest
    np.testing.assert_array_equal(one.sources, other.sources)
    assert made(generator, 2).record.digest != one.record.digest


def test_a_season_never_changes(generator: SeasonGenerator) -> None:
    # Tasks lock results that follow from these bits.
    assert made(generator, 1).record.digest == DIGEST


def test_another_process_makes_the_same_season(generator: SeasonGenerator) -> None:
    program = (
        "import datetime as dt, numpy as np; from glbench.weather import SeasonGenerator, load_weather\n"
        "g = SeasonGenerator(load_weather('schiphol'), (2010, 2008, 2009))\n"
        "print(g.season(dt.date(2010, 3, 1), 60, np.random.default_rng(3).random(g.numbers(60))).record.digest)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == made(generator, 3).record.digest


@pytest.mark.parametrize("years", [TRAINING, TEST, (2009,), (2008, 2010, 2012)])
def test_no_hour_of_another_year_enters(schiphol: WeatherRecord, years: tuple[int, ...]) -> None:
    begins = (schiphol.begin + 3600 * np.arange(schiphol.hours)).astype("datetime64[s]").astype("datetime64[Y]")
    own = np.isin(begins.astype(np.int64) + 1970, years)
    changed = {name: np.where(own, counts, counts // 3 + 777) for name, counts in schiphol.counts.items()}
    other = replace(schiphol, counts=MappingProxyType(changed))
    one, same = SeasonGenerator(schiphol, years), SeasonGenerator(other, years)
    for seed in range(5):
        start = dt.date(2010, 1, 1) + dt.timedelta(days=80 * seed)
        season = made(one, seed, start)
        assert season.record.digest == made(same, seed, start).record.digest
        used = season.sources.astype("datetime64[D]").astype("datetime64[Y]").astype(np.int64) + 1970
        assert set(used) <= set(years)


def test_years_in_any_order_and_twice_are_the_same_years(schiphol: WeatherRecord, generator: SeasonGenerator) -> None:
    mixed = SeasonGenerator(schiphol, [2010, 2008, 2009, 2008])
    assert mixed.years == TRAINING
    assert made(mixed, 5).record.digest == made(generator, 5).record.digest


def test_a_season_is_made_of_runs_of_whole_days(generator: SeasonGenerator) -> None:
    for season in some(generator):
        assert not season.joints[0]
        blocks = blocks_of(season)
        assert all((np.diff(block) == 1).all() for block in blocks)
        lengths = [block.size for block in blocks]
        assert 1 <= lengths[0] <= 10
        assert 1 <= lengths[-1] <= 10
        assert all(4 <= length <= 10 for length in lengths[1:-1])


def test_a_block_comes_from_the_same_time_of_the_year(generator: SeasonGenerator) -> None:
    for start in (SPRING, dt.date(2010, 12, 10)):
        for seed in range(20):
            season = made(generator, seed, start)
            first = (start - dt.date(1970, 1, 1)).days - MARGIN_DAYS
            place = calendar_days(first + np.arange(season.sources.size))
            apart = (calendar_days(season.sources) - place + 182) % 365 - 182
            begins = season.joints | (np.arange(season.joints.size) == 0)
            assert np.abs(apart[begins]).max() <= Blocks().window


def test_what_truly_came_next_and_the_last_ten_days_are_left_out(generator: SeasonGenerator) -> None:
    for season in some(generator):
        for joint in np.flatnonzero(season.joints):
            recent = season.sources[max(joint - 10, 0) : joint]
            block = season.sources[joint : joint + 4]
            assert block[0] != recent[-1] + 1
            assert not np.isin(np.append(block, block[0] - 1), recent).any()


def test_joints_are_equally_likely_on_all_days(generator: SeasonGenerator) -> None:
    joints = np.mean([made(generator, seed, days=30).joints[1:] for seed in range(600)], axis=0)
    # Blocks last 7 days on average; 600 seasons know a share of 1/7 to 0.014 (sd).
    np.testing.assert_allclose(joints, 1 / 7, atol=0.06)
    assert joints[:10].mean() == pytest.approx(1 / 7, abs=0.015)


def test_hours_away_from_joints_keep_their_joint_course(schiphol: WeatherRecord, generator: SeasonGenerator) -> None:
    for season in some(generator):
        near = season.joints | np.append(season.joints[1:], False)
        for name in ("relative_humidity", "wind_speed", "cloud_cover"):
            source = source_days(schiphol, season, name)
            if name == "cloud_cover":
                source = np.minimum(source, 8000)
            np.testing.assert_array_equal(days_of(season.record, name)[~near], source[~near])
        shift = days_of(season.record, "air_temperature") - source_days(schiphol, season, "air_temperature")
        assert np.abs(shift[~near]).max() < 3500  # the trend of twelve days or so
        assert np.ptp(shift[~near], axis=1).max() <= 200  # the same all day, to the grid of 0.1 degC


def test_a_season_changes_over_a_joint_as_the_block_did_when_it_began(schiphol: WeatherRecord, generator: SeasonGenerator) -> None:
    first = np.datetime64("2008-01-01", "D").astype(np.int64)
    for season in some(generator):
        joints = np.flatnonzero(season.joints)
        for name, grid in (("air_temperature", 100), ("relative_humidity", 1000), ("wind_speed", 1000)):
            hours, record = days_of(season.record, name), days_of(schiphol, name)
            inside = (hours[joints, 0] < 100_000) & (hours[joints - 1, -1] < 100_000) & (hours[joints, 0] > 0)
            inside &= hours[joints - 1, -1] > 0  # not clipped
            change = hours[joints, 0] - hours[joints - 1, -1]
            true = record[season.sources[joints] - first, 0] - record[season.sources[joints] - first - 1, -1]
            assert np.abs(change - true)[inside].max() <= 1.2 * grid


def test_a_mismatch_is_gone_after_a_day(schiphol: WeatherRecord, generator: SeasonGenerator) -> None:
    assert RAMP_HOURS == 24
    season = made(generator, 4)
    joint = int(np.flatnonzero(season.joints)[1])
    humidity = days_of(season.record, "relative_humidity") - source_days(schiphol, season, "relative_humidity")
    before, after = humidity[joint - 1], humidity[joint]
    assert abs(before[0]) <= 1000
    assert abs(after[-1]) <= 1000
    assert (np.diff(np.abs(before)) >= -1000).all()
    assert (np.diff(np.abs(after)) <= 1000).all()


def test_values_stay_on_the_grid_of_the_record_and_possible(generator: SeasonGenerator) -> None:
    grid = {"air_temperature": 100, "relative_humidity": 1000, "wind_speed": 1000, "global_radiation": 10_000, "cloud_cover": 1000}
    for season in some(generator):
        for name, counts in season.record.counts.items():
            assert counts.dtype == np.int64
            assert not counts.flags.writeable
            assert not (counts % grid[name]).any()
            quantity = QUANTITIES[name]
            high = 8.0 if name == "cloud_cover" else quantity.high
            assert quantity.low * quantity.counts_per_unit <= counts.min()
            assert counts.max() <= high * quantity.counts_per_unit


def test_radiation_keeps_its_clearness_under_the_sun_of_the_season(schiphol: WeatherRecord, generator: SeasonGenerator) -> None:
    clear = clear_sky(schiphol.place, 0)
    for season in some(generator, 8):
        first = (season.start - dt.date(1970, 1, 1)).days - MARGIN_DAYS
        place = calendar_days(first + np.arange(season.sources.size))
        here, there = clear[place], clear[calendar_days(season.sources)]
        high = (here > 50.0) & (there > 50.0)
        now, then = days_of(season.record, "global_radiation"), source_days(schiphol, season, "global_radiation")
        np.testing.assert_allclose((now / here.clip(1))[high], (then / there.clip(1))[high], atol=5000 / 50)
        same = place == calendar_days(season.sources)
        np.testing.assert_array_equal(now[same], then[same])
        assert (now[(here == 0.0) & (there > 0.0)] == 0).all()


def test_the_sun_is_that_of_pvlib_to_the_last_bit() -> None:
    days = np.arange(365)
    declination, minutes = spencer_1971(days)
    np.testing.assert_array_equal(declination, declination_spencer71(days + 1))
    np.testing.assert_array_equal(minutes, equation_of_time_spencer71(days + 1))


def test_the_clear_sky_is_that_of_the_place(schiphol: WeatherRecord) -> None:
    clear = clear_sky(schiphol.place, 0)
    daily = clear.mean(axis=1) * 0.0864
    assert 28.0 < daily[171] < 32.0  # MJ m-2 on the longest day at 52 deg N
    assert 2.0 < daily[354] < 4.5
    measured = schiphol.values("global_radiation").reshape(-1, 24).mean(axis=1) * 0.0864
    day = calendar_days(np.datetime64("2008-01-01", "D").astype(np.int64) + np.arange(measured.size))
    summer = (day > 120) & (day < 270)
    assert 0.95 < np.quantile((measured / daily[day])[summer], 0.99) < 1.05  # the brightest days are clear
    noon = clear.argmax(axis=1)
    assert set(noon) == {11}  # 11 to 12 h UTC; the sun stands south at 11:25 to 11:55


@pytest.mark.parametrize("zone", ["Europe/Amsterdam", "Etc/GMT+12", "Etc/GMT-14", "Asia/Kolkata"])
def test_the_season_and_a_day_of_forecast_can_be_read_on_every_clock(generator: SeasonGenerator, zone: str) -> None:
    season = made(generator, 6)
    record = replace(season.record, place=replace(season.record.place, timezone=zone))
    rows = disturbances(record, start=SPRING, steps=61 * 96, preprocessing="conserving")
    assert rows.hour_of_day[0] == 0.0
    assert np.isfinite(rows.values).all()
    disturbances(record, start=SPRING - dt.timedelta(days=1), steps=96, preprocessing="conserving")


def test_dates_are_nominal(generator: SeasonGenerator) -> None:
    season = made(generator, 7, dt.date(2031, 3, 1), 10)
    assert season.record.period == "2031-02-27 00:00 to 2031-03-13 00:00 UTC"
    assert season.sources.size == season.joints.size == 14
    assert "2008, 2009, 2010" in season.record.source
    assert "acknowledged" in season.record.licence
    same = made(generator, 7, dt.date(2030, 3, 1), 10)
    for name, counts in season.record.counts.items():
        np.testing.assert_array_equal(counts, same.record.counts[name])


def test_the_29_february_counts_as_the_28(schiphol: WeatherRecord) -> None:
    days = np.arange(np.datetime64("2012-02-27"), np.datetime64("2012-03-03"))
    assert calendar_days(days.astype(np.int64)).tolist() == [57, 58, 58, 59, 60]
    ends = np.array(["2011-12-31", "2012-12-31", "2000-12-31", "1900-03-01"], dtype="datetime64[D]").astype(np.int64)
    assert calendar_days(ends).tolist() == [364, 364, 364, 59]
    leap = SeasonGenerator(schiphol, (2008, 2012))
    used = np.concatenate([made(leap, seed, dt.date(2012, 2, 20), 20).sources for seed in range(40)])
    assert np.isin(np.array(["2008-02-29", "2012-02-29"], dtype="datetime64[D]").astype(np.int64), used).all()


def test_a_year_that_is_not_whole_is_named(schiphol: WeatherRecord) -> None:
    with pytest.raises(WeatherError, match=r"The year 2013 is not wholly in weather 'schiphol', which covers 2008"):
        SeasonGenerator(schiphol, (2012, 2013))
    cut = replace(schiphol, counts=MappingProxyType({n: c[:-5] for n, c in schiphol.counts.items()}))
    with pytest.raises(WeatherError, match="The year 2012 is not wholly in"):
        SeasonGenerator(cut, (2011, 2012))
    SeasonGenerator(cut, (2011,))
    with pytest.raises(WeatherError, match="without years"):
        SeasonGenerator(schiphol, ())


def test_impossible_arguments_are_refused(generator: SeasonGenerator) -> None:
    wanted = generator.numbers(60)
    for numbers in (np.zeros(wanted - 1), np.ones(wanted), np.full(wanted, np.nan), np.full(wanted, -0.1)):
        with pytest.raises(WeatherError, match=f"60 days is made of {wanted} random numbers from 0 to 1"):
            generator.season(SPRING, 60, numbers)
    with pytest.raises(WeatherError, match="starts on a datetime"):
        generator.season(dt.datetime(2010, 3, 1), 60, np.zeros(wanted))
    for days in (0, -1, 1.5):
        with pytest.raises(WeatherError, match="asked for of"):
            generator.numbers(days)  # type: ignore[arg-type]


@pytest.mark.parametrize("numbers", [0.0, np.nextafter(1.0, 0.0)])
def test_extreme_numbers_suffice_for_every_length(generator: SeasonGenerator, numbers: float) -> None:
    for days in (1, 2, 7, 60, 61, 300):
        season = generator.season(SPRING, days, np.full(generator.numbers(days), numbers))
        assert season.sources.size == days + 2 * MARGIN_DAYS
        assert (season.sources > 0).all()


@pytest.mark.parametrize("name", ["greensboro", "sand_point", "miami"])
def test_a_typical_year_gives_seasons_joined_at_night(name: str) -> None:
    record = load_weather(name)
    generator = SeasonGenerator(record, (2001,))
    ahead = round(record.longitude / 15.0) * 3600
    seasons = [made(generator, seed, start) for seed in range(4) for start in (SPRING, dt.date(2010, 12, 1))]
    assert len({season.record.digest for season in seasons}) == len(seasons)
    for season in seasons:
        assert (season.record.begin + ahead) % 86400 == 0
        radiation = days_of(season.record, "global_radiation")
        assert not radiation[:, [0, -1]].any()
        rows = disturbances(season.record, start=season.start, steps=61 * 96, preprocessing="conserving")
        assert np.isfinite(rows.values).all()


def test_the_hours_that_a_typical_year_lacks_come_from_its_other_end() -> None:
    record = load_weather("greensboro")
    _, hours = SeasonGenerator(record, (2001,)).real_days()
    temperature = record.values("air_temperature")
    np.testing.assert_array_equal(hours["air_temperature"].ravel()[:-5], temperature[5:])
    np.testing.assert_array_equal(hours["air_temperature"].ravel()[-5:], temperature[:5])


def test_a_record_with_slots_off_the_hour_is_cut_at_its_own_slots(schiphol: WeatherRecord) -> None:
    delhi = replace(schiphol, begin=schiphol.begin - 19800, place=replace(schiphol.place, longitude=77.0, timezone="Asia/Kolkata"))
    season = made(SeasonGenerator(delhi, (2009, 2010)), 1)
    assert (season.record.begin - delhi.begin) % 3600 == 0
    assert np.isfinite(disturbances(season.record, start=SPRING, steps=96, preprocessing="conserving").values).all()
