"""Exports of weather services: PVGIS, NSRDB, Open-Meteo, SolarAnywhere; what their stamps mean, and how they are refused."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.weather import WeatherRecord, load_weather, read_weather
from glbench.weather.readers import detect_format
from glbench.weather.reading import humidity_of_daily_minimum

DAY = dt.datetime(2023, 6, 1)


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., WeatherRecord]:
    """Record of a text (or bytes) as a file."""

    def record_of(text: str | bytes, **options: object) -> WeatherRecord:
        path = tmp_path / "export.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_weather(path, **options)

    return record_of


def moments(hours: float, minutes: int, first: dt.datetime = DAY) -> list[dt.datetime]:
    return [first + dt.timedelta(minutes=minutes * i) for i in range(round(hours * 60 / minutes))]


def sun(moment: dt.datetime) -> int:
    return 400 if 8 <= moment.hour < 16 else 0


# ---- NSRDB -------------------------------------------------------------------------------------------------------------------------


def nsrdb(
    minutes: int,
    *,
    zone: int = -7,
    local: int = -7,
    titles: str = "Relative Humidity",
    humidity: str = "70",
    first: dt.datetime | None = None,
    end: str = "",
) -> str:
    heading = "Source,Location ID,City,State,Country,Latitude,Longitude,Time Zone,Elevation,Local Time Zone"
    lines = [heading, f"NSRDB,401182,-,-,-,40.53,-108.54,{zone},2168,{local}"]
    lines.append(f"Year,Month,Day,Hour,Minute,GHI,DHI,{titles},Temperature,Wind Speed,Pressure{end}")
    begin = (first or DAY) + dt.timedelta(minutes=30 if minutes == 60 else 0)
    for moment in moments(48, minutes, begin):
        values = f"{sun(moment)},10,{humidity},{moment.hour},2.5,780{end}"
        lines.append(f"{moment.year},{moment.month},{moment.day},{moment.hour},{moment.minute},{values}")
    return "\n".join(lines) + "\n"


def test_hourly_nsrdb_rows_are_the_hour_around_their_stamp(read: Callable[..., WeatherRecord]) -> None:
    record = read(nsrdb(60))
    assert record.period == "2023-06-01 07:00 to 2023-06-03 07:00 UTC"
    assert record.timezone == "Etc/GMT+7"
    assert (record.latitude, record.longitude, record.altitude) == (40.53, -108.54, 2168.0)
    assert record.values("global_radiation")[7:10].tolist() == [0.0, 400.0, 400.0]
    assert record.values("air_temperature")[:3].tolist() == [0.0, 1.0, 2.0]
    assert record.timing["air_temperature"] == record.timing["global_radiation"] == "mean"


@pytest.mark.parametrize("minutes", [5, 10, 15, 30])
def test_finer_nsrdb_rows_are_averaged_about_their_middles(read: Callable[..., WeatherRecord], minutes: int) -> None:
    record = read(nsrdb(minutes))
    assert record.period == "2023-06-01 07:00 to 2023-06-03 07:00 UTC"
    radiation = record.values("global_radiation")
    # Of the hour before 08:00, half an interval belongs to the row of 08:00.
    assert radiation[7] == pytest.approx(400 * minutes / 2 / 60, abs=1e-3)
    assert radiation.sum() == pytest.approx(2 * 8 * 400, abs=1e-2)
    assert record.notes[0] == f"stamps are the middles of intervals of {minutes} min"


def test_nsrdb_rows_in_utc_keep_the_local_clock(read: Callable[..., WeatherRecord]) -> None:
    record = read(nsrdb(60, zone=0))
    assert record.period == "2023-06-01 00:00 to 2023-06-03 00:00 UTC"
    assert record.timezone == "Etc/GMT+7"
    assert read(nsrdb(60, zone=0), timezone="America/Denver").timezone == "America/Denver"


def test_nsrdb_humidity_comes_from_the_dew_point_where_there_is_none(read: Callable[..., WeatherRecord]) -> None:
    record = read(nsrdb(60, titles="Dew Point", humidity="-5", end=","))
    humidity = record.values("relative_humidity")
    assert humidity[0] == pytest.approx(100 * 421.8 / 610.78, abs=0.5)  # -5 degC in air of 0 degC
    assert "relative humidity from the dew point" in record.notes


def test_an_nsrdb_file_without_temperature_is_refused(read: Callable[..., WeatherRecord]) -> None:
    with pytest.raises(WeatherError, match=r"no column 'Temperature', which is needed. It has: Year, Month"):
        read(nsrdb(60).replace(",Temperature,", ",Other,"))


def test_a_clock_that_does_not_exist_is_refused(read: Callable[..., WeatherRecord]) -> None:
    with pytest.raises(WeatherError, match=r"a clock that is 7e\+07 h from UTC does not exist"):
        read(nsrdb(60, zone=70000000))


def test_a_file_of_pvgis_without_titles_is_refused(read: Callable[..., WeatherRecord]) -> None:
    with pytest.raises(WeatherError, match="holds no hourly values of PVGIS: there is no line of titles"):
        read(pvgis_hourly().replace("time,", "moment,"), file_format="pvgis")


def test_a_value_of_an_nsrdb_file_is_named(read: Callable[..., WeatherRecord]) -> None:
    with pytest.raises(WeatherError, match=r"export\.csv, row 4, column 'GHI': 'x' is not a number"):
        read(nsrdb(60).replace(",30,0,10", ",30,x,10", 1))
    with pytest.raises(WeatherError, match=r"row 4, column 'Year, Month, Day, Hour': the time '2023-02-30 00:00' does not"):
        read(nsrdb(60).replace("2023,6,1,0", "2023,2,30,0", 1))


# ---- Open-Meteo --------------------------------------------------------------------------------------------------------------------

OPEN_METEO = "latitude,longitude,elevation,utc_offset_seconds,timezone,timezone_abbreviation"
UNITS = ("°C", "km/h")


def open_meteo(
    rows: Iterable[str],
    *,
    place: str = "52.0,4.4,1.0,0,GMT,GMT",
    units: tuple[str, str] = UNITS,
    sky: str = "cloud_cover (%)",
    names: tuple[str, str] = ("relative_humidity_2m", "wind_speed_10m"),
    more: str = "",
) -> str:
    title = f"time,temperature_2m ({units[0]}),{names[0]} (%),{sky},{names[1]} ({units[1]}),shortwave_radiation (W/m²)"
    return "\n".join([OPEN_METEO, place, "", title, *rows, ""]) + more


def open_meteo_row(stamp: str, hour: int, temperature: float = 10.0, wind: float = 36.0) -> str:
    return f"{stamp},{temperature},80,50,{wind},{hour}"


def hourly_rows(count: int, zone: dt.tzinfo = dt.UTC, first: dt.datetime = DAY) -> list[str]:
    """Rows of hours that follow each other in UTC, on the clock of ``zone``; the radiation counts them."""
    begin = first.replace(tzinfo=zone).astimezone(dt.UTC)
    return [open_meteo_row((begin + dt.timedelta(hours=i)).astimezone(zone).strftime("%Y-%m-%dT%H:%M"), i) for i in range(count)]


def test_open_meteo_radiation_is_the_mean_of_the_hour_before(read: Callable[..., WeatherRecord]) -> None:
    record = read(open_meteo(hourly_rows(48)))
    assert record.period == "2023-05-31 23:00 to 2023-06-02 23:00 UTC"
    assert record.values("global_radiation")[:3].tolist() == [0.0, 1.0, 2.0]
    assert record.timing["global_radiation"] == "mean"
    assert record.timing["air_temperature"] == "instant"
    assert record.values("wind_speed")[0] == 10.0
    assert record.values("cloud_cover")[0] == 4.0
    assert "Open-Meteo" in record.licence


@pytest.mark.parametrize(
    ("units", "temperature", "wind"),
    [(("°F", "mp/h"), 50.0, 22.369), (("°C", "kn"), 10.0, 19.438), (("°C", "m/s"), 10.0, 10.0), (("°C", "mph"), 10.0, 22.369)],
)
def test_open_meteo_units_are_converted(
    read: Callable[..., WeatherRecord], units: tuple[str, str], temperature: float, wind: float
) -> None:
    rows = [open_meteo_row(f"2023-06-01T{hour:02d}:00", 0, temperature, wind) for hour in range(24)]
    record = read(open_meteo(rows, units=units))
    assert record.values("air_temperature")[0] == pytest.approx(10.0, abs=1e-3)
    assert record.values("wind_speed")[0] == pytest.approx(10.0, abs=1e-3)


def test_an_unknown_open_meteo_unit_is_refused(read: Callable[..., WeatherRecord]) -> None:
    with pytest.raises(
        WeatherError, match=r"column 'wind_speed_10m \(furlong\)': the unit 'furlong' is unknown. Known are m/s, km/h, mph, kn"
    ):
        read(open_meteo(hourly_rows(24), units=("°C", "furlong")))


def test_older_names_and_other_blocks_of_open_meteo_are_read(read: Callable[..., WeatherRecord]) -> None:
    daily = "\ntime,temperature_2m_max (°C),sunrise (iso8601)\n2023-06-01,20.1,2023-06-01T05:20\n2023-06-02,21.3,2023-06-02T05:19\n"
    text = open_meteo(hourly_rows(48), names=("relativehumidity_2m", "windspeed_10m"), sky="cloudcover (%)", more=daily)
    assert read(text).hours == 48
    assert read(text.encode("utf-16")).hours == 48
    assert read(text.encode("latin-1")).hours == 48
    with pytest.raises(WeatherError, match=r"holds no hourly values. Choose hourly variables"):
        read("\n".join([OPEN_METEO, "52.0,4.4,1.0,0,GMT,GMT", daily]))


def test_quarter_hours_of_open_meteo_are_averaged(read: Callable[..., WeatherRecord]) -> None:
    rows = [open_meteo_row(f"{moment:%Y-%m-%dT%H:%M}", moment.minute) for moment in moments(48, 15)]
    record = read(open_meteo(rows))
    # The hour to 01:00 has the rows of 00:15, 00:30, 00:45 and 01:00.
    assert record.period == "2023-06-01 00:00 to 2023-06-02 23:00 UTC"
    assert record.values("global_radiation")[0] == 22.5


def test_unix_seconds_of_open_meteo_are_utc(read: Callable[..., WeatherRecord]) -> None:
    rows = [open_meteo_row(str(int(moment.replace(tzinfo=dt.UTC).timestamp())), 5) for moment in moments(24, 60)]
    record = read(open_meteo(rows, place="52.0,4.4,1.0,7200,Europe/Amsterdam,CEST"))
    assert record.period == "2023-05-31 23:00 to 2023-06-01 23:00 UTC"
    assert record.timezone == "Europe/Amsterdam"


@pytest.mark.parametrize("first", [dt.datetime(2023, 3, 25), dt.datetime(2023, 10, 28)])
def test_open_meteo_stamps_may_follow_summer_time_or_a_fixed_offset(read: Callable[..., WeatherRecord], first: dt.datetime) -> None:
    zone = ZoneInfo("Europe/Berlin")
    offset = round((first.replace(tzinfo=zone).utcoffset() or dt.timedelta()).total_seconds())
    place = f"52.0,13.4,38.0,{offset},Europe/Berlin,CET"
    changing = read(open_meteo(hourly_rows(72, zone, first), place=place))
    fixed = read(open_meteo(hourly_rows(72, dt.timezone(dt.timedelta(seconds=offset)), first), place=place))
    assert changing.digest == fixed.digest
    assert changing.values("global_radiation").tolist() == list(range(72))
    assert any("all year" in note for note in fixed.notes)


def test_open_meteo_without_a_zone_gets_that_of_the_longitude(read: Callable[..., WeatherRecord]) -> None:
    record = read(open_meteo(hourly_rows(24), place="35.7,139.7,NaN,0,GMT,GMT"))
    assert record.timezone == "Etc/GMT-9"
    assert record.altitude == 0.0
    assert "the altitude is unknown: 0 m is taken" in record.notes
    assert read(open_meteo(hourly_rows(24)), coordinates=(1.0, 2.0, 3.0)).altitude == 3.0


def test_several_places_in_one_open_meteo_file_are_refused(read: Callable[..., WeatherRecord]) -> None:
    text = open_meteo(hourly_rows(24), place="52.0,4.4,1.0,0,GMT,GMT\n53.0,5.4,1.0,0,GMT,GMT")
    with pytest.raises(WeatherError, match=r"holds 2 places. Download one place a file"):
        read(text)


# ---- PVGIS -------------------------------------------------------------------------------------------------------------------------

PVGIS_PLACE = "Latitude (decimal degrees): 45.000\nLongitude (decimal degrees):\t8.000\nElevation (m): 250.0\n"
PVGIS_LEGEND = "\nT2m: 2-m air temperature (degree Celsius)\nRH: relative humidity (%)\n\nPVGIS (c) European Union, 2001-2025\n"


def pvgis_typical(offset: str = "0.25", march: int = 2007) -> str:
    years = "\n".join(f"{month},{2004 + month}" for month in range(1, 13))
    lines = [f"{PVGIS_PLACE}Irradiance Time Offset (h): {offset}\nmonth,year\n{years}"]
    lines.append("time(UTC),T2m,RH,G(h),Gb(n),Gd(h),IR(h),WS10m,WD10m,SP")
    for moment in moments(8760, 60, dt.datetime(2001, 1, 1)):
        year = {2: 2007, 3: march}.get(moment.month, 2004 + moment.month)
        stamp = f"{moment.replace(year=year):%Y%m%d:%H%M}"
        lines.append(f"{stamp},{moment.hour},80,{sun(moment)},0,0,300,2.0,180,99000")
    return "\n".join(lines) + "\n" + PVGIS_LEGEND


def pvgis_hourly(columns: str = "G(i)", values: str = "400", slope: str = "0") -> str:
    lines = [f"{PVGIS_PLACE}Radiation database:\tPVGIS-SARAH3\n\nSlope: {slope} deg.\nAzimuth: 0 deg."]
    lines.append(f"time,{columns},H_sun,T2m,WS10m,Int")
    first = DAY + dt.timedelta(minutes=10)
    lines += [f"{moment:%Y%m%d:%H%M},{values},30.0,{10 + moment.hour},2.0,0.0" for moment in moments(49, 60, first)]
    return "\n".join(lines) + "\n\nG(i): Global irradiance\n\n\nPVGIS (c) European Union, 2001-2025\n"


def test_a_typical_year_of_pvgis_is_whole_and_its_radiation_in_place(read: Callable[..., WeatherRecord]) -> None:
    record = read(pvgis_typical())
    assert record.period == "2001-01-01 00:00 to 2002-01-01 00:00 UTC"
    assert record.typical_year
    assert (record.latitude, record.longitude, record.altitude, record.timezone) == (45.0, 8.0, 250.0, "Etc/GMT-1")
    # T2m of 01:00 is the instant at the end of the first slot.
    assert record.values("air_temperature")[:2].tolist() == [1.0, 2.0]
    # The instants of 07:15 (dark) and 08:15 (400): of the hour to 08:00, the part after 07:45 is nearer to the second.
    assert record.values("global_radiation")[6:9].tolist() == [0.0, 100.0, 400.0]
    # With 0.6 h these are the instants of 07:36 and 08:36: the hour from 08:00 has the first for six minutes.
    assert read(pvgis_typical("0.6")).values("global_radiation")[6:10].tolist() == pytest.approx([0.0, 0.0, 360.0, 400.0])
    assert record.values("sky_infrared")[0] == 300.0
    assert read(pvgis_typical(), timezone="Europe/Rome", year=2013).first.year == 2013


def test_a_typical_year_of_pvgis_may_have_the_march_of_a_leap_year(read: Callable[..., WeatherRecord]) -> None:
    usual, leap = read(pvgis_typical()), read(pvgis_typical(march=2008))
    assert leap.hours == 8760
    for name in ("air_temperature", "global_radiation", "sky_infrared"):
        np.testing.assert_array_equal(leap.values(name), usual.values(name))


def test_a_typical_year_of_pvgis_in_json_is_the_same(read: Callable[..., WeatherRecord]) -> None:
    text = pvgis_typical()
    header = "time(UTC),T2m,RH,G(h),Gb(n),Gd(h),IR(h),WS10m,WD10m,SP"
    body = text.split(header + "\n")[1].split("\n\n")[0]
    rows = [
        {"time(UTC)": fields[0], **{title: float(field) for title, field in zip(header.split(",")[1:], fields[1:], strict=True)}}
        for fields in (line.split(",") for line in body.splitlines())
    ]
    place = {"latitude": 45.0, "longitude": 8.0, "elevation": 250.0, "irradiance_time_offset": 0.25}
    document = {"inputs": {"location": place}, "outputs": {"tmy_hourly": rows}}
    assert read(json.dumps(document)).digest == read(text).digest
    with pytest.raises(WeatherError, match="holds no hourly values of PVGIS"):
        read(json.dumps({"outputs": {"tmy_hourly": None}}), file_format="pvgis")
    with pytest.raises(WeatherError, match="is no weather of PVGIS"):
        read("{", file_format="pvgis")


@pytest.mark.parametrize(("columns", "values"), [("G(i)", "400"), ("Gb(i),Gd(i),Gr(i)", "300,100,0")])
def test_hourly_pvgis_has_no_humidity_unless_it_is_estimated(read: Callable[..., WeatherRecord], columns: str, values: str) -> None:
    with pytest.raises(WeatherError, match=r"has no humidity, .* --estimate-humidity"):
        read(pvgis_hourly(columns, values))
    record = read(pvgis_hourly(columns, values), estimate_humidity=True)
    # Instants at minute 10 stand for the hour around them, from minute 40 to 40.
    assert record.period == "2023-06-01 00:00 to 2023-06-03 00:00 UTC"
    assert record.values("global_radiation").tolist() == [400.0] * 48
    assert record.values("air_temperature")[0] == pytest.approx((40 * 10 + 20 * 11) / 60, abs=1e-3)
    humidity = record.values("relative_humidity")
    assert humidity[0] > 97.0 > humidity[12]  # the lowest temperature of the day is the dew point
    assert any("FAO-56" in note for note in record.notes)


def test_radiation_on_a_tilted_plane_is_refused(read: Callable[..., WeatherRecord]) -> None:
    with pytest.raises(WeatherError, match=r"tilted plane \(slope 30.0\). The greenhouse needs global horizontal radiation"):
        read(pvgis_hourly(slope="30"), estimate_humidity=True)
    with pytest.raises(WeatherError, match="tilted plane"):
        read(pvgis_hourly(slope="35 (optimum)"), estimate_humidity=True)


def test_the_place_can_be_supplied(read: Callable[..., WeatherRecord]) -> None:
    text = "time(UTC)" + pvgis_typical().split("time(UTC)")[1]
    with pytest.raises(WeatherError, match=r"does not say where it was measured. Give it with --place"):
        read(text)
    assert read(text, coordinates=(45.0, 8.0, 250.0)).longitude == 8.0


# ---- SolarAnywhere, and formats ----------------------------------------------------------------------------------------------------


def solar_anywhere(averaging: str = "End of Period") -> str:
    about = f'"Data Version: 3.6 / Type: Timeseries / Averaging Method: {averaging} / Copyright"'
    titles = "ObservationTime(LST),Global Horizontal Irradiance (GHI) W/m2,AmbientTemperature (deg C),WindSpeed (m/s),Relative Humidity (%)"
    first = DAY + dt.timedelta(minutes=30)
    rows = [f"{moment:%m/%d/%Y %H:%M},{sun(moment)},10,2,80" for moment in moments(48, 30, first)]
    return "\n".join([f"0,Burlington,NA,-5,44.465,-73.205,41,{about}", titles, *rows, ""])


def test_solar_anywhere_is_read(read: Callable[..., WeatherRecord]) -> None:
    record = read(solar_anywhere())
    assert record.period == "2023-06-01 05:00 to 2023-06-03 05:00 UTC"
    assert record.values("global_radiation")[7:9].tolist() == [200.0, 400.0]
    with pytest.raises(WeatherError, match="not means to the end of a period"):
        read(solar_anywhere("Instantaneous"))


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (nsrdb(60), "nsrdb"),
        (open_meteo(hourly_rows(24)), "openmeteo"),
        (pvgis_hourly(), "pvgis"),
        (pvgis_typical(), "pvgis"),
        (solar_anywhere(), "solaranywhere"),
        ('LOCATION,"A, B",-,NLD,TMYx,1,52,5,1,0\n', "epw"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_formats_are_recognised_in_every_encoding(tmp_path: Path, text: str, kind: str, encoding: str) -> None:
    path = tmp_path / "http_site.dat"
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    assert detect_format(path) == kind


def test_an_option_of_another_format_is_refused(read: Callable[..., WeatherRecord]) -> None:
    with pytest.raises(WeatherError, match="read as nsrdb, which takes no --estimate-humidity"):
        read(nsrdb(60), estimate_humidity=True)
    with pytest.raises(WeatherError, match=r"the real years 2022 to 2023: --year is only for typical years"):
        read(nsrdb(60, first=dt.datetime(2022, 12, 31)), year=2001)


def test_a_record_of_two_real_years_is_no_typical_year(read: Callable[..., WeatherRecord]) -> None:
    record = read(nsrdb(60, first=dt.datetime(2022, 12, 31)))
    assert not record.typical_year
    assert np.diff(record.values("global_radiation")).max() == 400.0


def test_the_error_of_the_estimated_humidity_is_as_documented() -> None:
    schiphol = load_weather("schiphol")
    hours = (366 + 365 + 365) * 24  # 2008 to 2010
    ends = schiphol.begin + 3600 * np.arange(1, schiphol.hours + 1)
    estimate = humidity_of_daily_minimum(ends, schiphol.values("air_temperature"))[:hours]
    error = estimate - schiphol.values("relative_humidity")[:hours]
    page = (Path(__file__).parents[2] / "docs" / "weather.md").read_text(encoding="utf-8")
    rms, mean = f"{np.sqrt(np.mean(error**2)):.1f}", f"{np.mean(error):.1f}".replace("-", "−")
    assert f"is off by {rms} % of relative humidity (root mean square), {mean} % on average" in " ".join(page.split())
