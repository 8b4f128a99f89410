"""The preprocessing ``conserving``: sums kept exactly, values at their right time, local clock."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.weather import Disturbances, Place, WeatherRecord, conserving, disturbances, load_weather, preprocessing
from glbench.weather.conserving import sine_of_elevation
from glbench.weather.record import Timing

IGLOB, TOUT, VP, CO2, WIND, TSKY, SOIL, RADSUM, DAY, DAYSMOOTH = range(10)
YEAR_BEGIN = dt.datetime(2010, 1, 1, tzinfo=dt.UTC)


@pytest.fixture(scope="module")
def schiphol() -> WeatherRecord:
    return load_weather("schiphol")


@pytest.fixture(scope="module")
def year(schiphol: WeatherRecord) -> Disturbances:
    return disturbances(schiphol, start=YEAR_BEGIN, steps=365 * 96, preprocessing="conserving")


def slot(record: WeatherRecord, moment: dt.datetime) -> int:
    return int((moment - record.first).total_seconds()) // 3600


def test_every_hour_of_a_year_keeps_its_radiation(schiphol: WeatherRecord, year: Disturbances) -> None:
    first = slot(schiphol, YEAR_BEGIN)
    measured = schiphol.values("global_radiation", first, first + 8760)
    made = year.values[:, IGLOB].reshape(8760, 4).mean(axis=1)
    np.testing.assert_allclose(made, measured, rtol=1e-14, atol=0)
    assert measured.sum() * 3600e-6 == pytest.approx(np.sum(year.values[:, IGLOB]) * 900e-6, rel=1e-14)


@pytest.mark.parametrize("step", [300, 600, 1200, 1800, 3600])
def test_every_step_that_divides_the_hour_keeps_hourly_radiation(schiphol: WeatherRecord, step: int) -> None:
    start = dt.datetime(2011, 6, 20, tzinfo=dt.UTC)
    made = disturbances(schiphol, start=start, steps=5 * 86400 // step, step_seconds=step, preprocessing="conserving")
    measured = schiphol.values("global_radiation", slot(schiphol, start), slot(schiphol, start) + 120)
    np.testing.assert_allclose(made.values[:, IGLOB].reshape(120, -1).mean(axis=1), measured, rtol=1e-14)


def test_steps_that_straddle_hours_keep_the_sum(schiphol: WeatherRecord) -> None:
    start = dt.datetime(2011, 6, 20, tzinfo=dt.UTC)
    for step in (700, 5040, 43200):
        steps = 7 * 86400 // step  # all three divide 7 days
        made = disturbances(schiphol, start=start, steps=steps, step_seconds=step, preprocessing="conserving")
        energy = schiphol.counts["global_radiation"][slot(schiphol, start) :][: 7 * 24].sum()
        assert made.values[:, IGLOB].sum() * step == pytest.approx(energy, rel=1e-13)
        wind = schiphol.values("wind_speed", slot(schiphol, start), slot(schiphol, start) + 168)
        assert made.values[:, WIND].mean() == pytest.approx(wind.mean(), rel=1e-13)


def test_every_hour_of_a_year_keeps_its_mean_wind(schiphol: WeatherRecord, year: Disturbances) -> None:
    first = slot(schiphol, YEAR_BEGIN)
    measured = schiphol.values("wind_speed", first, first + 8760)
    np.testing.assert_array_equal(year.values[:, WIND].reshape(8760, 4), np.repeat(measured[:, None], 4, axis=1))


def test_temperature_runs_linearly_between_slot_ends(schiphol: WeatherRecord, year: Disturbances) -> None:
    first = slot(schiphol, YEAR_BEGIN)
    # T of slot HH is the temperature at HH:00; the four steps of an hour are the means over its quarters.
    ends = schiphol.values("air_temperature", first - 1, first + 8760)
    quarters = ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(4) + 0.5) / 4
    np.testing.assert_allclose(year.values[:, TOUT].reshape(8760, 4), quarters, rtol=0, atol=1e-13)


def test_vapour_pressure_runs_linearly_between_slot_ends(schiphol: WeatherRecord, year: Disturbances) -> None:
    first = slot(schiphol, YEAR_BEGIN)
    t = schiphol.values("air_temperature", first - 1, first + 8760)
    vp = schiphol.values("relative_humidity", first - 1, first + 8760) / 100 * 610.78 * np.exp(17.2694 * t / (t + 238.3))
    quarters = vp[:-1, None] + np.diff(vp)[:, None] * (np.arange(4) + 0.5) / 4
    np.testing.assert_allclose(year.values[:, VP].reshape(8760, 4), quarters, rtol=1e-13)


def test_an_invisible_sky_counts_as_overcast(schiphol: WeatherRecord) -> None:
    invisible = {**schiphol.counts, "cloud_cover": np.full_like(schiphol.counts["cloud_cover"], 9000)}
    overcast = {**schiphol.counts, "cloud_cover": np.full_like(schiphol.counts["cloud_cover"], 8000)}
    made = [
        disturbances(replace(schiphol, counts=counts), start=YEAR_BEGIN, steps=48, preprocessing="conserving").values
        for counts in (invisible, overcast)
    ]
    np.testing.assert_array_equal(made[0], made[1])
    # Eight octants are a full cover: 10 degC would give 6.95 degC, 3 K below the air.
    assert (made[0][:, TOUT] - made[0][:, TSKY] < 4.5).all()


def test_an_overcast_sky_is_warmer_than_the_papers_ninths_make_it(schiphol: WeatherRecord) -> None:
    overcast = replace(schiphol, counts={**schiphol.counts, "cloud_cover": np.full_like(schiphol.counts["cloud_cover"], 8000)})
    start = dt.datetime(2010, 3, 1, tzinfo=dt.UTC)
    paper = disturbances(overcast, start=start, steps=960)
    conserving = disturbances(overcast, start=start, steps=960, preprocessing="conserving")
    difference = float(np.mean(conserving.values[:, TSKY] - paper.values[:, TSKY]))
    assert 1.5 < difference < 2.3


def test_no_radiation_falls_in_the_dark(schiphol: WeatherRecord, year: Disturbances) -> None:
    begins = year.times.astype(np.int64)
    corners = np.stack([sine_of_elevation((begins + s).astype(np.float64), schiphol.place) for s in (0, 450, 900)])
    night = corners.max(axis=0) < -np.sin(np.radians(6.0)) - 0.01
    assert night.sum() > 10000
    assert (year.values[night, IGLOB] == 0.0).all()


def test_radiation_never_exceeds_what_the_sun_can_send(schiphol: WeatherRecord, year: Disturbances) -> None:
    middle = sine_of_elevation(year.times.astype(np.float64) + 450.0, schiphol.place)
    sunlit = middle > 0.05
    assert (year.values[sunlit, IGLOB] / middle[sunlit]).max() < 1361.0
    assert year.values[~sunlit, IGLOB].max() < 50.0


def test_hourly_energy_without_any_sun_is_kept_and_spread_evenly(schiphol: WeatherRecord) -> None:
    start = dt.datetime(2010, 1, 1, tzinfo=dt.UTC)
    energy = schiphol.counts["global_radiation"].copy()
    energy[slot(schiphol, start)] = 10000  # 1 J cm-2 in the middle of the night
    lit = replace(schiphol, counts={**schiphol.counts, "global_radiation": energy})
    made = disturbances(lit, start=start, steps=4, preprocessing="conserving")
    np.testing.assert_allclose(made.values[:, IGLOB], 1 / 0.36, rtol=1e-14)


def test_twilight_energy_does_not_become_a_flash_of_sun(schiphol: WeatherRecord) -> None:
    # 17 March 2010: the sun rises at 05:57 UTC. Three minutes of sun cannot give the 2 J cm-2 of this hour: twilight does.
    start = dt.datetime(2010, 3, 17, 5, tzinfo=dt.UTC)
    energy = schiphol.counts["global_radiation"].copy()
    energy[slot(schiphol, start)] = 20000
    lit = replace(schiphol, counts={**schiphol.counts, "global_radiation": energy})
    made = disturbances(lit, start=start, steps=12, step_seconds=300, preprocessing="conserving").values[:, IGLOB]
    assert made.mean() == pytest.approx(2 / 0.36, rel=1e-14)
    assert made.max() < 25.0
    assert (np.diff(made) >= 0).all()


@pytest.mark.parametrize("step", [900, 700])
def test_rows_do_not_depend_on_the_window_asked_for(schiphol: WeatherRecord, step: int) -> None:
    start = dt.datetime(2010, 5, 7, tzinfo=dt.UTC)
    long = disturbances(schiphol, start=start, steps=1260, step_seconds=step, preprocessing="conserving")
    later = start + dt.timedelta(seconds=600 * step)
    short = disturbances(schiphol, start=later, steps=300, step_seconds=step, preprocessing="conserving")
    np.testing.assert_allclose(short.values, long.values[600:900], rtol=1e-12, atol=1e-10)


def test_a_date_begins_at_local_midnight(schiphol: WeatherRecord) -> None:
    winter = disturbances(schiphol, start=dt.date(2010, 1, 10), steps=4, preprocessing="conserving")
    summer = disturbances(schiphol, start=dt.date(2010, 7, 10), steps=4, preprocessing="conserving")
    assert winter.times[0] == np.datetime64("2010-01-09T23:00:00")
    assert summer.times[0] == np.datetime64("2010-07-09T22:00:00")
    assert winter.hour_of_day[0] == summer.hour_of_day[0] == 0.0
    assert (winter.day_of_year[0], summer.day_of_year[0]) == (9.0, 190.0)


def test_the_day_of_year_is_that_of_the_local_calendar(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.date(2010, 3, 27), steps=72, step_seconds=3600, preprocessing="conserving")
    np.testing.assert_allclose(made.day_of_year % 1.0, made.hour_of_day / 24.0, atol=1e-12)
    assert made.day_of_year[[0, 24, 47, 71]].astype(int).tolist() == [85, 86, 87, 88]  # the 28th has 23 hours


def test_the_clock_jumps_forward_when_summer_time_begins(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.date(2010, 3, 28), steps=24, step_seconds=3600, preprocessing="conserving")
    np.testing.assert_array_equal(made.hour_of_day[:5], [0, 1, 3, 4, 5])
    # 23 hours later it is the next day.
    assert made.hour_of_day[23] == 0.0
    assert made.times[23] == np.datetime64("2010-03-28T22:00:00")


def test_the_clock_falls_back_when_summer_time_ends(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.date(2010, 10, 31), steps=26, step_seconds=3600, preprocessing="conserving")
    np.testing.assert_array_equal(made.hour_of_day[:5], [0, 1, 2, 2, 3])
    assert made.hour_of_day[25] == 0.0


def test_the_days_radiation_sum_belongs_to_the_local_day(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.date(2010, 6, 20), steps=192, preprocessing="conserving")
    # The local day of 20 June (CEST) runs from 22:00 to 22:00 UTC.
    first = slot(schiphol, dt.datetime(2010, 6, 19, 22, tzinfo=dt.UTC))
    for day in (0, 1):
        energy = schiphol.counts["global_radiation"][first + 24 * day :][:24].sum()
        np.testing.assert_allclose(made.values[96 * day : 96 * day + 96, RADSUM], energy * 1e-6, rtol=1e-14)


def test_the_local_day_lasts_23_hours_when_summer_time_begins(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.date(2010, 3, 28), steps=96, preprocessing="conserving")
    days = np.flatnonzero(np.diff(made.values[:, RADSUM])) + 1
    assert days.tolist() == [92]
    first = slot(schiphol, dt.datetime(2010, 3, 27, 23, tzinfo=dt.UTC))
    assert made.values[0, RADSUM] == pytest.approx(schiphol.counts["global_radiation"][first:][:23].sum() * 1e-6)


def test_day_flag_is_half_at_sunrise_and_ramps_for_an_hour(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.datetime(2010, 3, 20, tzinfo=dt.UTC), steps=1440, step_seconds=60, preprocessing="conserving")
    sine = sine_of_elevation(made.times.astype(np.float64) + 30.0, schiphol.place)
    sunrise = int(np.flatnonzero(sine > 0)[0])
    flag, smooth = made.values[:, DAY], made.values[:, DAYSMOOTH]
    assert flag[sunrise] == pytest.approx(0.5, abs=0.05)
    assert (flag[: sunrise - 35] == 0).all()
    assert (flag[sunrise + 35 : sunrise + 300] == 1).all()
    rising = flag[sunrise - 25 : sunrise + 25]
    np.testing.assert_allclose(np.diff(rising[::5]), 5 / 60, atol=1e-12)
    assert smooth[sunrise] == pytest.approx(0.5, abs=0.13)
    assert ((smooth >= 0) & (smooth <= 1)).all()


def test_the_midnight_sun_makes_days_without_an_end(schiphol: WeatherRecord) -> None:
    tromso = replace(schiphol, place=Place("Tromso", 69.65, 18.96, 10.0, "Europe/Oslo"))
    june = disturbances(tromso, start=dt.date(2010, 6, 20), steps=96, preprocessing="conserving")
    december = disturbances(tromso, start=dt.date(2010, 12, 20), steps=96, preprocessing="conserving")
    assert (june.values[:, DAY] == 1).all()
    assert (december.values[:, DAY] == 0).all()
    # Schiphol's December noon has radiation that Tromso's sun cannot give: it is kept nevertheless.
    assert december.values[:, IGLOB].sum() > 0


def test_the_first_hour_and_the_last_local_day_of_the_record_can_be_used(schiphol: WeatherRecord) -> None:
    first = disturbances(schiphol, start=schiphol.first, steps=4, preprocessing="conserving")
    # No temperature is known at the very beginning, so the first slot's own is held.
    np.testing.assert_array_equal(first.values[:, TOUT], schiphol.values("air_temperature", 0, 1)[0])
    # The record ends at 00:00 UTC, one hour into a local day whose sum nobody knows: the last usable hour ends at 23:00 UTC.
    last = disturbances(schiphol, start=schiphol.last - dt.timedelta(hours=2), steps=4, preprocessing="conserving")
    ends = schiphol.values("air_temperature", schiphol.hours - 3)
    np.testing.assert_allclose(last.values[:, TOUT], ends[0] + (ends[1] - ends[0]) * (np.arange(4) + 0.5) / 4)


def test_a_local_day_with_missing_daylight_is_refused(schiphol: WeatherRecord) -> None:
    shortened = replace(schiphol, counts={k: v[12:] for k, v in schiphol.counts.items()}, begin=schiphol.begin + 12 * 3600)
    with pytest.raises(WeatherError, match="daylight hours from 2007-12-31 23:00 to 2008-01-01 12:00 UTC are missing"):
        disturbances(shortened, start=shortened.first, steps=4, preprocessing="conserving")


def test_values_that_are_means_are_held_through_their_slot(schiphol: WeatherRecord) -> None:
    timing: dict[str, Timing] = dict.fromkeys(schiphol.timing, "mean")
    means = replace(schiphol, timing=timing)
    made = disturbances(means, start=YEAR_BEGIN, steps=8, preprocessing="conserving")
    first = slot(schiphol, YEAR_BEGIN)
    np.testing.assert_array_equal(made.values[:, TOUT], np.repeat(schiphol.values("air_temperature", first, first + 2), 4))


def test_sun_stands_where_the_almanac_says() -> None:
    # NREL's worked example of the algorithm (Reda and Andreas, 2004): 17 October 2003, 12:30:30 at UTC-7, topocentric zenith
    # 50.11162 deg with refraction; without it the elevation is 39.872046 deg. Delta T is 67 s there too.
    moment = dt.datetime(2003, 10, 17, 19, 30, 30, tzinfo=dt.UTC).timestamp()
    golden = Place("Golden", 39.742476, -105.1786, 1830.14, "America/Denver")
    elevation = np.degrees(np.arcsin(sine_of_elevation(np.array([moment]), golden)))[0]
    assert elevation == pytest.approx(39.872046, abs=1e-5)


def test_what_is_remembered_of_sun_and_clock_changes_no_bit(schiphol: WeatherRecord) -> None:
    for start, steps in ((dt.date(2010, 3, 20), 96 * 12), (dt.date(2011, 10, 25), 96 * 9), (dt.date(2010, 3, 21), 96 * 12)):
        conserving._sine_in_block.cache_clear()
        preprocessing._offsets_of_day.cache_clear()
        fresh = disturbances(schiphol, start=start, steps=steps, preprocessing="conserving")
        again = disturbances(schiphol, start=start, steps=steps, preprocessing="conserving")
        for name in ("values", "hour_of_day", "day_of_year"):
            np.testing.assert_array_equal(getattr(fresh, name), getattr(again, name))
    # Any window, also off the hour, has the bits that it has when the sun is worked out for it alone.
    for begin, slots in (
        (int(YEAR_BEGIN.timestamp()), 30),
        (1267401600 - 3600, 24 * 66),
        (1267403400, 500),
        (1267401700, 50),
        (-5 * 86400, 24 * 5),
    ):
        middles = begin + 300 * (np.arange(slots * 12) + 0.5)
        sine = conserving.sines_over(schiphol.place, begin, slots)
        assert sine.shape == (slots, 12)
        np.testing.assert_array_equal(sine.ravel(), sine_of_elevation(middles, schiphol.place))
        sine[:] = 0.0  # what is handed out is not what is remembered
        assert conserving.sines_over(schiphol.place, begin, slots).any()


@pytest.mark.parametrize("clock", ["Europe/Amsterdam", "America/Anchorage", "Australia/Lord_Howe", "Asia/Kolkata", "UTC"])
def test_the_clock_is_looked_up_at_every_quarter(clock: str) -> None:
    rng = np.random.default_rng(1)
    changes = [int(dt.datetime(2010, month, day, tzinfo=dt.UTC).timestamp()) for month, day in ((3, 28), (10, 31), (4, 3), (11, 7))]
    times = np.concatenate([change + rng.integers(-90_000, 90_000, 200) for change in changes])
    zone = ZoneInfo(clock)
    expected = [dt.datetime.fromtimestamp(int(t), tz=zone).utcoffset() for t in times]
    made = preprocessing.utc_offsets(times, clock)
    assert made.tolist() == [int((offset or dt.timedelta()).total_seconds()) for offset in expected]
