"""From rows of any step to hours: averages, limits of sensors, the estimated sky."""

from __future__ import annotations

import calendar
import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.weather import load_weather, read_csv
from glbench.weather.hourly import SKY_ESTIMATED, sky_infrared
from glbench.weather.preprocessing import sky_temperature_from_cloud, sky_temperature_from_infrared

PLACE = "# latitude: 52.0\n# longitude: 5.0\n# altitude: 0\n# timezone: Europe/Amsterdam\n"
TITLES = "slot_start [UTC],air_temperature [degC],relative_humidity [%],wind_speed [m/s],global_radiation [W/m2]"


def table(
    folder: Path,
    minutes: float,
    rows: list[tuple[float, float, float, float]],
    begin: str = "2024-06-01T10:00",
    *,
    skip: tuple[int, ...] = (),
) -> Path:
    first = dt.datetime.fromisoformat(begin)
    stamps = [(first + dt.timedelta(minutes=minutes * i)).isoformat() for i in range(len(rows))]
    lines = [f"{stamps[i]}Z,{','.join(map(str, row))}" for i, row in enumerate(rows) if i not in skip]
    path = folder / "table.csv"
    path.write_text(PLACE + TITLES + "\n" + "\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("minutes", [1, 5, 10, 15, 30])
def test_finer_steps_are_averaged_to_hours(tmp_path: Path, minutes: int) -> None:
    count = 3 * 60 // minutes
    rows = [(10.0 + i / 10, 50.0, 2.0, 100.0 * (i % 2)) for i in range(count)]
    record = read_csv(table(tmp_path, minutes, rows))
    means = np.array([row[0] for row in rows]).reshape(3, -1).mean(axis=1)
    np.testing.assert_allclose(record.values("air_temperature"), means, atol=5e-4)
    np.testing.assert_allclose(record.values("global_radiation"), 50.0, atol=1e-3)
    assert set(record.timing.values()) == {"mean"}
    assert record.notes[0] == f"rows of {minutes} min averaged to hours; 3 h"


def test_hours_that_lie_half_an_hour_off_are_split(tmp_path: Path) -> None:
    record = read_csv(table(tmp_path, 60, [(10.0, 50, 2, 0), (20.0, 50, 2, 100), (30.0, 50, 2, 200)], begin="2024-06-01T10:30"))
    assert record.first.hour == 11
    np.testing.assert_allclose(record.values("air_temperature"), [15.0, 25.0])
    np.testing.assert_allclose(record.values("global_radiation"), [50.0, 150.0])


def test_an_hour_needs_half_of_its_rows(tmp_path: Path) -> None:
    rows = [(float(i), 50.0, 2.0, 0.0) for i in range(30)]
    some = read_csv(table(tmp_path, 10, rows, skip=(13, 14)))
    np.testing.assert_allclose(some.values("air_temperature")[2], np.mean([12, 15, 16, 17]))
    assert any("1 h are means of an hour with missing rows" in note for note in some.notes)
    with pytest.raises(WeatherError, match="--fill-gaps 1"):
        read_csv(table(tmp_path, 10, rows, skip=(12, 13, 14, 15)))
    gap = read_csv(table(tmp_path, 10, rows, skip=(12, 13, 14, 15)), fill_gaps=1)
    assert gap.hours == 5
    assert SKY_ESTIMATED in gap.notes


def test_only_the_first_and_last_hour_of_a_file_may_be_there_in_part(tmp_path: Path) -> None:
    rows = [(15.0, 50.0, 2.0, 0.0)] * 60
    lost = read_csv(table(tmp_path, 10, rows, "2024-06-01T10:20", skip=tuple(range(25, 60, 6))))  # one row of each hour in the later half
    assert lost.period == "2024-06-01 11:00 to 2024-06-01 20:00 UTC"
    assert any("6 h are means of an hour with missing rows" in note for note in lost.notes)
    path = table(tmp_path, 10, rows)
    path.write_text("".join(line.replace(",2.0,", ",,") if i >= 40 else line for i, line in enumerate(path.read_text().splitlines(True))))
    with pytest.raises(WeatherError, match="no value for wind speed"):  # a sensor that fails is no shorter file
        read_csv(path)
    some = read_csv(table(tmp_path, 10, rows, "2024-06-01T10:20", skip=tuple(range(5, 60, 6))))
    assert some.hours == 9, "half of an hour's rows will do, also in every hour"


def test_a_humidity_sensor_that_fails_is_not_called_the_sky(tmp_path: Path) -> None:
    record = read_csv(table(tmp_path, 60, [(10.0, 0.0, 2.0, 0.0)] * 3))
    assert record.values("relative_humidity").tolist() == [0.0] * 3
    assert (record.values("sky_infrared") > 100.0).all()


def test_readings_of_sensors_are_set_to_their_limits_and_larger_ones_refused(tmp_path: Path) -> None:
    record = read_csv(table(tmp_path, 60, [(10.0, 103.0, 2.0, -4.0), (10.0, 99.0, 2.0, 0.0)]))
    assert record.values("global_radiation")[0] == 0.0
    assert record.values("relative_humidity")[0] == 100.0
    assert "global_radiation: 1 values as far as -4 W/m2 set to 0 W/m2 (the offset of a pyranometer at night)" in record.notes
    with pytest.raises(WeatherError, match="row 6: relative humidity of 120 %"):
        read_csv(table(tmp_path, 60, [(10.0, 120.0, 2.0, 0.0)]))


def test_rows_out_of_order_and_too_coarse_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match="its rows are 3 h apart"):
        read_csv(table(tmp_path, 180, [(10.0, 50, 2, 0)] * 4))


def test_the_error_of_the_estimated_sky_is_what_the_page_says() -> None:
    """Against the sky of observed clouds at Schiphol, 2008 to 2010 (years of training)."""
    record = load_weather("schiphol")
    begin, end = (calendar.timegm((year, 1, 1, 0, 0, 0)) for year in (2008, 2011))
    hours = slice((begin - record.begin) // 3600, (end - record.begin) // 3600)
    temperature, humidity, radiation, cloud = (
        record.values(name, hours.start, hours.stop) for name in ("air_temperature", "relative_humidity", "global_radiation", "cloud_cover")
    )
    observed = sky_temperature_from_cloud(temperature, np.minimum(cloud, 8.0) / 8.0)
    estimated = sky_temperature_from_infrared(sky_infrared(temperature, humidity, radiation, begin, record.place))
    constant = sky_temperature_from_cloud(temperature, np.full(cloud.size, float(np.minimum(cloud, 8.0).mean()) / 8.0))
    error, without = estimated - observed, constant - observed
    page = " ".join((Path(__file__).parents[2] / "docs" / "weather.md").read_text().split())
    assert f"{np.sqrt(np.mean(error**2)):.1f} K (root mean square), {error.mean():+.1f} K on average".replace("-", "−") in page
    assert f"the mean cloud cover instead would be off by {np.sqrt(np.mean(without**2)):.1f} K" in page
    assert f"{np.sqrt(np.mean(error**2)):.1f} K (root mean square)" in SKY_ESTIMATED


def test_the_sky_of_the_polar_night_is_half_clouded() -> None:
    place = load_weather("schiphol").place
    begin = calendar.timegm((2020, 12, 20, 0, 0, 0))
    north = type(place)("north", 80.0, 20.0, 0.0, "Etc/GMT-1")
    temperature = np.full(24, -10.0)
    infrared = sky_infrared(temperature, np.full(24, 80.0), np.zeros(24), begin, north)
    black_body = 5.6697e-8 * 263.15**4
    assert 0.8 * black_body < infrared[0] < 0.9 * black_body
