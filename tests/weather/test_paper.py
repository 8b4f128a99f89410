"""The preprocessing ``paper``: the published pipeline, value for value, and the three recommended corrections."""

from __future__ import annotations

import datetime as dt
import json
import math
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.weather import Disturbances, WeatherRecord, disturbances, load_weather
from glbench.weather.paper import day_flags
from glbench.weather.preprocessing import co2_density, sky_temperature_from_cloud, sky_temperature_from_infrared, soil_temperature

GOLDEN = Path(__file__).parent.parent / "golden"
IGLOB, TOUT, VP, CO2, WIND, TSKY, SOIL, RADSUM, DAY, DAYSMOOTH = range(10)


@pytest.fixture(scope="module")
def schiphol() -> WeatherRecord:
    return load_weather("schiphol")


@pytest.fixture(scope="module")
def spring(schiphol: WeatherRecord) -> Disturbances:
    return disturbances(schiphol, start=dt.date(2010, 3, 1), steps=5760)


def hourly(record: WeatherRecord, name: str, slot_start: dt.datetime) -> float:
    slot = int((slot_start.replace(tzinfo=dt.UTC) - record.first).total_seconds()) // 3600
    return float(record.values(name, slot, slot + 1)[0])


def test_rows_equal_the_published_table_of_2010(schiphol: WeatherRecord) -> None:
    rows = np.array(json.loads((GOLDEN / "weather_paper_rows.json").read_text())["rows"])
    made = disturbances(schiphol, start=dt.date(2010, 1, 1), steps=288, step_seconds=300).values
    ours = made[(rows[:, 0] / 300).astype(int)]
    np.testing.assert_allclose(ours[:, IGLOB], rows[:, 1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours[:, WIND], rows[:, 2], rtol=0, atol=1e-13)
    np.testing.assert_allclose(ours[:, TOUT], rows[:, 3], rtol=0, atol=1e-13)
    np.testing.assert_allclose(ours[:, TSKY], rows[:, 4], rtol=0, atol=1e-10)
    saturation = 610.78 * np.exp(17.2694 * rows[:, 3] / (rows[:, 3] + 238.3))
    np.testing.assert_allclose(ours[:, VP], rows[:, 5] / 100 * saturation, rtol=1e-12)


def test_a_row_calculated_by_hand(schiphol: WeatherRecord, spring: Disturbances) -> None:
    # Row 34 of the spring is 1 March 2010 08:30 UTC: half way from the slot that starts at 08 h to the one at 09 h.
    eight, nine = dt.datetime(2010, 3, 1, 8), dt.datetime(2010, 3, 1, 9)

    def half_way(name: str) -> float:
        return (hourly(schiphol, name, eight) + hourly(schiphol, name, nine)) / 2

    def sky(moment: dt.datetime) -> float:
        t, c = hourly(schiphol, "air_temperature", moment), hourly(schiphol, "cloud_cover", moment) / 9
        clear = (213 + 5.5 * t) / (5.67e-8 * (t + 273.15) ** 4)
        return float(((1 - 0.84 * c) * clear + 0.84 * c) ** 0.25 * (t + 273.15) - 273.15)

    t = half_way("air_temperature")
    row = spring.values[34]
    assert spring.times[34] == np.datetime64("2010-03-01T08:30:00")
    assert row[IGLOB] == pytest.approx(half_way("global_radiation"), rel=1e-14)
    assert row[TOUT] == pytest.approx(t, rel=1e-14)
    vapour = half_way("relative_humidity") / 100 * 610.78 * math.exp(17.2694 * t / (t + 238.3))
    assert row[VP] == pytest.approx(vapour, rel=1e-13)
    assert row[CO2] == pytest.approx(101325 * 400 * 44.01e-3 / (8.3144598 * (t + 273.15)), rel=1e-13)
    assert row[WIND] == pytest.approx(half_way("wind_speed"), rel=1e-14)
    assert row[TSKY] == pytest.approx((sky(eight) + sky(nine)) / 2, rel=1e-12)
    seconds = (59 * 24 + 8.5) * 3600
    assert row[SOIL] == pytest.approx(10 + 5 * math.sin(2 * math.pi * (seconds + 0.625 * 31536000) / 31536000), rel=1e-13)
    assert (row[DAY], row[DAYSMOOTH]) == (1.0, 1.0)


def test_the_days_radiation_sum_is_that_of_the_whole_calendar_day(schiphol: WeatherRecord, spring: Disturbances) -> None:
    sums = spring.values[:, RADSUM].reshape(60, 96)
    assert (sums == sums[:, :1]).all()
    # 1 March 2010: dark at both midnights, so the sum of the 5-minute lines is the sum of KNMI's 24 hourly values.
    day = [hourly(schiphol, "global_radiation", dt.datetime(2010, 3, 1, h)) for h in range(24)]
    assert sums[0, 0] == pytest.approx(sum(day) * 3600e-6, rel=1e-12)


def test_the_control_grid_is_exact_over_60_days(spring: Disturbances) -> None:
    assert spring.times[0] == np.datetime64("2010-03-01T00:00:00")
    assert spring.times[-1] == np.datetime64("2010-04-29T23:45:00")
    assert (np.diff(spring.times) == np.timedelta64(900, "s")).all()


def test_the_clock_is_utc_and_the_day_of_the_year_counts_from_nought(spring: Disturbances) -> None:
    np.testing.assert_array_equal(spring.hour_of_day[:5], [0.0, 0.25, 0.5, 0.75, 1.0])
    assert spring.hour_of_day[95] == 23.75
    assert spring.hour_of_day[96] == 0.0
    assert spring.day_of_year[0] == 59.0
    np.testing.assert_allclose(spring.day_of_year, 59.0 + np.arange(5760) / 96, rtol=0, atol=1e-12)


def test_a_quarter_of_an_hour_takes_every_third_node_of_the_5_minute_grid(schiphol: WeatherRecord) -> None:
    coarse = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=960)
    fine = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=2880, step_seconds=300)
    np.testing.assert_array_equal(coarse.values, fine.values[::3])


def test_other_steps_run_monotonely_between_the_nodes(schiphol: WeatherRecord) -> None:
    nodes = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=289, step_seconds=300).values
    between = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=864, step_seconds=100).values
    np.testing.assert_array_equal(between[::3], nodes[:-1])
    low, high = np.minimum(nodes[:-1], nodes[1:]), np.maximum(nodes[:-1], nodes[1:])
    for offset in (1, 2):
        assert (between[offset::3] >= low - 1e-9).all()
        assert (between[offset::3] <= high + 1e-9).all()
    assert not np.allclose(between[1::3, IGLOB], nodes[:-1, IGLOB])


def test_pchip_is_really_cubic(schiphol: WeatherRecord) -> None:
    # At 10 min before a bend of the hourly line, PCHIP and the straight line agree; next to the bend they differ.
    made = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=1440, step_seconds=60).values[:, TOUT]
    straight = np.interp(np.arange(1440), np.arange(0, 1440, 5), made[::5])
    inside = np.arange(1440) % 60
    middle = (inside >= 10) & (inside < 50)
    np.testing.assert_allclose(made[middle], straight[middle], atol=1e-12)
    assert np.abs(made - straight)[~middle][:-10].max() > 1e-4


@pytest.mark.parametrize("step", [900, 700])
def test_rows_do_not_depend_on_the_window_asked_for(schiphol: WeatherRecord, step: int) -> None:
    start = dt.datetime(2010, 5, 7)
    long = disturbances(schiphol, start=start, steps=1260, step_seconds=step)
    later = start + dt.timedelta(seconds=600 * step)
    short = disturbances(schiphol, start=later, steps=300, step_seconds=step)
    np.testing.assert_allclose(short.values, long.values[600:900], rtol=1e-12, atol=1e-10)


def test_radiation_is_never_negative_or_a_rounding_crumb(schiphol: WeatherRecord) -> None:
    radiation = disturbances(schiphol, start=dt.date(2010, 1, 1), steps=40000, step_seconds=700).values[:, IGLOB]
    assert (radiation >= 0).all()
    assert not ((radiation > 0) & (radiation < 1e-10)).any()


def test_soil_is_6_46_degrees_on_new_years_day() -> None:
    assert soil_temperature(np.array([0.0]))[0] == pytest.approx(6.464466094067262, abs=1e-13)


def test_sky_temperatures_at_10_degrees() -> None:
    made = sky_temperature_from_cloud(np.full(3, 10.0), np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(made, [-10.9468, -1.55448, 6.95360], atol=6e-5)


def test_sky_temperature_from_infrared_inverts_the_black_body() -> None:
    assert sky_temperature_from_infrared(np.array([5.6697e-8 * 273.15**4]))[0] == pytest.approx(0.0, abs=1e-12)


def test_400_ppm_at_20_degrees_weigh_731_82_mg() -> None:
    assert co2_density(np.array([20.0]), 400.0)[0] == pytest.approx(731.8195984832029, rel=1e-14)


def test_a_new_co2_concentration_scales_the_density(schiphol: WeatherRecord, spring: Disturbances) -> None:
    double = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=96, co2_ppm=800.0)
    np.testing.assert_allclose(double.values[:, CO2], 2 * spring.values[:96, CO2], rtol=1e-14)


def test_soil_starts_anew_on_new_years_day(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.date(2009, 12, 31), steps=192)
    assert made.values[96, SOIL] == pytest.approx(6.464466094067262, abs=1e-12)


def test_a_year_end_is_followed_without_a_jump(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.date(2008, 12, 31), steps=192)
    assert made.times[96] == np.datetime64("2009-01-01T00:00:00")
    # 23:30 UTC lies half way from the last slot of 2008 to the first of 2009.
    expected = (
        hourly(schiphol, "air_temperature", dt.datetime(2008, 12, 31, 23)) + hourly(schiphol, "air_temperature", dt.datetime(2009, 1, 1, 0))
    ) / 2
    assert made.values[94, TOUT] == pytest.approx(expected, rel=1e-13)
    # 2008 was a leap year: 31 December is day 365. The count starts anew with the year.
    assert (made.day_of_year[0], made.day_of_year[95]) == (365.0, 365.0 + 95 / 96)
    assert (made.day_of_year[96], made.day_of_year[191]) == (0.0, 95 / 96)


def test_the_leap_day_is_there(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.datetime(2012, 2, 28, 12), steps=192)
    assert made.times[48] == np.datetime64("2012-02-29T00:00:00")
    assert made.times[144] == np.datetime64("2012-03-01T00:00:00")
    assert made.day_of_year[144] == 60.0
    noon = hourly(schiphol, "air_temperature", dt.datetime(2012, 2, 29, 12))
    assert made.values[96, TOUT] == pytest.approx(noon, rel=1e-14)


def test_the_last_hour_of_the_record_is_held(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=dt.datetime(2012, 12, 31, 22), steps=24, step_seconds=300)
    last = hourly(schiphol, "air_temperature", dt.datetime(2012, 12, 31, 23))
    np.testing.assert_array_equal(made.values[12:, TOUT], last)


def test_day_flag_ramps_over_one_hour_around_the_edges_of_light() -> None:
    light = np.zeros(288, dtype=bool)
    light[100:200] = True
    linear, smooth = day_flags(light)
    # Edges after samples 99 and 199: samples 93..104 and 193..204 become ramps of 12 samples from 0 to 1.
    np.testing.assert_allclose(linear[93:105], np.arange(12) / 11, atol=1e-15)
    np.testing.assert_allclose(linear[193:205], 1 - np.arange(12) / 11, atol=1e-15)
    assert not linear[:93].any()
    assert (linear[105:193] == 1).all()
    assert smooth[93] == pytest.approx(1 / (1 + math.exp(5)))
    assert smooth[104] == pytest.approx(1 / (1 + math.exp(-5)))
    assert smooth[193] == pytest.approx(1 / (1 + math.exp(-5)))


def test_day_flag_edges_close_together_look_at_the_unedited_light() -> None:
    light = np.zeros(288, dtype=bool)
    light[100:104] = True
    linear, _ = day_flags(light)
    # The later edge (after sample 103) overrides samples 97..108 of the earlier ramp (93..104).
    np.testing.assert_allclose(linear[93:97], np.arange(4) / 11)
    np.testing.assert_allclose(linear[97:109], 1 - np.arange(12) / 11)


def test_day_flag_edges_in_the_first_and_last_hour_stay_hard() -> None:
    light = np.zeros(100, dtype=bool)
    light[5:95] = True
    linear, smooth = day_flags(light)
    np.testing.assert_array_equal(linear, light)
    np.testing.assert_array_equal(smooth, light)


def test_a_partly_covered_day_is_refused(schiphol: WeatherRecord) -> None:
    from dataclasses import replace

    shortened = replace(schiphol, counts={k: v[6:] for k, v in schiphol.counts.items()}, begin=schiphol.begin + 6 * 3600)
    with pytest.raises(WeatherError, match="only a part of the day 2008-01-01"):
        disturbances(shortened, start=dt.datetime(2008, 1, 1, 12), steps=4)
    assert disturbances(shortened, start=dt.datetime(2008, 1, 2), steps=4).values.shape == (4, 10)
