"""``glbench weather``: list, show, import, fetch and generate weather records."""

from __future__ import annotations

import dataclasses
import datetime as dt
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from glbench.cli import console
from glbench.cli.console import Markup, styled
from glbench.cli.options import AsJson, check_file, check_new, numbers_of
from glbench.cli.progress import status_bar
from glbench.errors import WeatherError, refuse
from glbench.extras import require

if TYPE_CHECKING:
    from glbench.weather import WeatherInfo, WeatherRecord

_MONTHLY = (
    ("mean T [degC]", "air_temperature_mean", 1),
    ("min T [degC]", "air_temperature_min", 1),
    ("max T [degC]", "air_temperature_max", 1),
    ("RH [%]", "relative_humidity_mean", 1),
    ("VPD [kPa]", "vapour_pressure_deficit_mean", 2),
    ("wind [m/s]", "wind_speed_mean", 2),
    ("global [MJ/m2]", "radiation_sum", 2),
    ("DLI [mol/m2/d]", "daily_light_integral_mean", 1),
)
"""Columns of the months: heading with unit, field, decimals."""
_OF_INFO = ("hours", "source", "licence", "digest", "origin", "typical_year")
_EXAMPLE = "a range such as 2008-2010, or a list such as 2008,2010"
_OF_RECORD = ("source", "licence", "digest", "typical_year")

app = typer.Typer(help="List, show, import, fetch and generate weather records.", no_args_is_help=True)

Source = Annotated[str, typer.Option("--source", help="Name of a record, as in `glbench weather list`.")]
Years = Annotated[str, typer.Option("--years", help="Years to draw from: 2008-2010, or 2008,2010.")]
Days = Annotated[int, typer.Option("--days", min=1, help="Length of a season [d].")]
Replace = Annotated[bool, typer.Option("--replace", help="Replace your own record of that name.")]
FillGaps = Annotated[int, typer.Option("--fill-gaps", min=0, max=48, help="Fill up to this many missing hours in a row linearly; noted.")]


@app.command("list")
def list_records(as_json: AsJson = False) -> None:
    """List the shipped weather records and your own."""
    from glbench.weather import list_weather

    infos = list_weather()
    view = _table("Weather records", ["name", "station", "period [UTC]", "hours [h]", "origin", "SHA-256"])
    for info in infos:
        view.add(
            info.name,
            info.place.station,
            f"{_moment(info.first)} to {_moment(info.last)}",
            f"{info.hours:,}",
            info.origin + (", typical year" if info.typical_year else ""),
            info.digest[:8],
        )
    document = {"records": [_as_json(info, *_OF_INFO, path=str(info.path)) for info in infos]}
    console.show(console.View([view], document), as_json=as_json)


@app.command("show")
def show_record(
    name: Annotated[str, typer.Argument(help="Name of a record, as in `glbench weather list`.")],
    month: Annotated[str | None, typer.Option("--month", help="Only this month: 2010-03, or 3 for every March.", metavar="MONTH")] = None,
    as_json: AsJson = False,
) -> None:
    """Show where a record comes from, and its monthly means and sums."""
    from glbench.weather import load_weather
    from glbench.weather.summary import UNITS, monthly

    record = load_weather(name)
    months = monthly(record, month)
    # Where both are known the sky's infrared is what the preprocessings use; the JSON has both.
    sky = ("infrared [W/m2]", "sky_infrared_mean", 1)
    if "sky_infrared" not in record.counts:
        sky = ("cloud [octants]", "cloud_cover_mean", 1)
    columns = (*_MONTHLY, sky)
    # ten columns fit a terminal of 80
    view = _table("Months (UTC)", ["month", *(heading for heading, _, _ in columns)], padding=0)
    for row in months:
        values = [(getattr(row, name), digits) for _, name, digits in columns]
        view.add(row.month, *("-" if value is None else f"{value:.{digits}f}" for value, digits in values))
    facts = _as_json(record, *_OF_RECORD, timing=dict(record.timing))
    document = {**facts, "units": dict(UNITS), "months": [asdict(row) for row in months]}
    console.show(console.View([*description(record), view], document), as_json=as_json)


@app.command("import")
def import_file(
    file: Annotated[
        Path,
        typer.Argument(
            help="KNMI, EPW, TMY2, TMY3, PVGIS, NSRDB (PSM), Open-Meteo, SolarAnywhere, CSV, or Parquet of glbench; alone in a zip, too."
        ),
    ],
    name: Annotated[str, typer.Option("--name", help="Name of the new record: lower-case letters, digits, . _ -")],
    file_format: Annotated[
        str,
        typer.Option(
            "--format", help="auto (looks at the content), knmi, epw, tmy, pvgis, nsrdb, openmeteo, solaranywhere, csv or parquet."
        ),
    ] = "auto",
    timezone: Annotated[
        str | None, typer.Option(help="IANA zone of the local clock, such as Europe/Amsterdam; overrides that of the file.")
    ] = None,
    year: Annotated[int | None, typer.Option(help="Typical years: the common year that they get (2001).")] = None,
    station: Annotated[int | None, typer.Option(help="KNMI: number of the station, in a file of several.")] = None,
    place: Annotated[
        str | None,
        typer.Option(
            "--place", metavar="LAT,LON,ALT", help="Degrees north, degrees east, metres above sea level; overrides those of the file."
        ),
    ] = None,
    columns: Annotated[
        Path | None, typer.Option("--columns", help="Column map (TOML) of the file, as `glbench weather columns` writes it.")
    ] = None,
    estimate_humidity: Annotated[
        bool, typer.Option("--estimate-humidity", help="PVGIS, hourly series: take the day's lowest temperature for the dew point.")
    ] = False,
    fill_gaps: FillGaps = 0,
    replace: Replace = False,
) -> None:
    """Check a weather file and keep it under a name."""
    from glbench.weather import read_weather, save_weather
    from glbench.weather.store import check_new_name

    check_new_name(name, overwrite=replace)
    coordinates = None
    if place is not None:
        try:
            latitude, longitude, altitude = (float(part) for part in place.split(","))
        except ValueError:
            msg = f"--place '{place}' is not a latitude and a longitude in degrees and an altitude in m, such as 52.0,4.5,-4."
            raise WeatherError(msg) from None
        coordinates = (latitude, longitude, altitude)
    record = read_weather(
        file,
        file_format,
        name=name,
        timezone=timezone,
        year=year,
        station=station,
        coordinates=coordinates,
        columns=columns,
        estimate_humidity=estimate_humidity,
        fill_gaps=fill_gaps,
    )
    _report_saved(record, save_weather(record, name, overwrite=replace))


@app.command("columns")
def columns_of(
    file: Annotated[Path, typer.Argument(help="A table, such as the export of a climate computer.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The map's file; FILE with .columns.toml by default.")] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace a map that exists.")] = False,
    as_json: AsJson = False,
) -> None:
    """Propose which column of a table is what, and write it as a column map for you to check."""
    from glbench.weather import guess_column_map, write_column_map

    path = out or file.with_suffix(".columns.toml")
    check_new(path, replace=replace)
    columns, checks, unused = guess_column_map(file)
    write_column_map(columns, checks, unused, file, path)
    view = console.table(f"Columns of {file.name}", "quantity", "column", "unit", "check", fold=("column", "check"))
    view.add("time", " and ".join(columns.time), columns.dates or "", "start, middle or end of the interval? which clock?")
    for quantity, entry in columns.columns.items():
        view.add(quantity, entry.column, entry.unit, checks.get(quantity, ""))
    name = console.quoted(file)
    lines = [
        *([console.Line(f"Left out: {', '.join(unused)}")] if unused else []),
        console.Line(f"Written: {path}. Check it, then:"),
        console.Line(f"  glbench weather import {name} --name NAME --columns {console.quoted(path)} --place LATITUDE,LONGITUDE,ALTITUDE"),
    ]
    document = {**columns.model_dump(exclude_none=True), "check": checks, "unused": unused, "file": str(path)}
    console.show(console.View([view, *lines], document), as_json=as_json)


@app.command("export")
def export(
    name: Annotated[str, typer.Argument(help="Name of a record, as in `glbench weather list`.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The file (.csv); `glbench weather import` reads it again.")],
    replace: Annotated[bool, typer.Option("--replace", help="Replace a file that exists.")] = False,
) -> None:
    """Write a record as a CSV with units in its titles and the place in its comments."""
    from glbench.weather import load_weather
    from glbench.weather.store import write_csv

    record = load_weather(name)
    check_new(out, replace=replace)
    write_csv(record, out)
    console.write(f"Weather '{name}': {record.period}, {record.hours:,} h, SHA-256 {record.digest[:12]}, in {out}")


@app.command("fetch")
def fetch(
    station: Annotated[int, typer.Option("--station", help="KNMI's number of the station; 240 is Schiphol.")],
    year: Annotated[int, typer.Option("--year", help="Calendar year (UT).")],
    name: Annotated[str | None, typer.Option("--name", help="Name of the new record; knmi-STATION-YEAR by default.")] = None,
    url: Annotated[str | None, typer.Option("--url", help="Address of the service.", envvar="GLBENCH_KNMI_URL", show_envvar=True)] = None,
    timeout: Annotated[float, typer.Option("--timeout", min=0.1, help="Longest silence of the service [s].")] = 60.0,
    total_timeout: Annotated[float, typer.Option("--total-timeout", min=0.1, help="Longest time of the whole download [s].")] = 600.0,
    refresh: Annotated[bool, typer.Option("--refresh", help="Ask the service even if the answer is in the cache.")] = False,
    fill_gaps: FillGaps = 0,
    replace: Replace = False,
) -> None:
    """Download a station and year from KNMI, check it, and keep it under a name."""
    from rich.progress import DownloadColumn

    from glbench.weather import fetch_knmi, save_weather
    from glbench.weather.store import check_new_name

    name = name or f"knmi-{station}-{year}"
    check_new_name(name, overwrite=replace)
    with status_bar(f"KNMI station {station}, {year}", None, DownloadColumn()) as update:
        record = fetch_knmi(
            station,
            year,
            name=name,
            url=url,
            timeout_seconds=timeout,
            total_seconds=total_timeout,
            refresh=refresh,
            fill_gaps=fill_gaps,
            progress=lambda received, total: update(completed=received, total=total),
        )
    _report_saved(record, save_weather(record, name, overwrite=replace))


@app.command("generate")
def generate(
    out: Annotated[Path, typer.Option("--out", "-o", help="The season's file (.parquet); `import` reads it again.")],
    source: Source = "schiphol",
    years: Years = "2008-2010",
    start: Annotated[str, typer.Option("--start", help="First day, such as 2010-03-01.")] = "2010-03-01",
    days: Days = 60,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another seed, another season.")] = 1,
    picture: Annotated[Path | None, typer.Option("--picture", help="Also a picture (.png): the season beside the real years.")] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace files that exist.")] = False,
) -> None:
    """Make a season that never was, from blocks of days of real years."""
    if picture is not None:
        require("--picture", "video", "matplotlib")
    import numpy as np

    from glbench.weather import SeasonGenerator, load_weather
    from glbench.weather.comparison import write_picture
    from glbench.weather.store import write_record

    for path, suffix in ((out, ".parquet"), (picture, ".png")):
        check_file(path, suffix)
        if path is not None:
            check_new(path, replace=replace)
    generator = SeasonGenerator(load_weather(source), numbers_of(years, "years", _EXAMPLE))
    season = generator.season(_date(start), days, np.random.default_rng(seed).random(generator.numbers(days)))
    record = dataclasses.replace(season.record, notes=(*season.record.notes, f"seed {seed}, {days} days from {start}"))
    write_record(record, out)
    console.write(
        f"Season of {console.count(days, 'day')} from {start}, seed {seed}: {record.period}, SHA-256 {record.digest[:12]}, in {out}"
    )
    console.write(f"Its source: {record.source}")
    console.write(f"Keep it under a name: glbench weather import {console.quoted(out)} --name NAME")
    if picture is not None:
        write_picture(generator, season, picture)
        console.write(f"Picture in {picture}")


@app.command("statistics")
def statistics(
    source: Source = "schiphol",
    years: Years = "2008-2010",
    start: Annotated[str, typer.Option("--start", help="First possible first day; its year does not matter.")] = "2010-02-15",
    within_days: Annotated[int, typer.Option("--within-days", min=0, help="How many later first days are possible.")] = 28,
    days: Days = 60,
    seasons: Annotated[int, typer.Option("--seasons", min=20, help="Number of generated seasons.")] = 1000,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of their random numbers.")] = 1,
    shortest: Annotated[int | None, typer.Option("--shortest", min=1, help="Shortest block [d], to try another generator.")] = None,
    longest: Annotated[int | None, typer.Option("--longest", min=1, help="Longest block [d].")] = None,
    window: Annotated[int | None, typer.Option("--window", min=1, help="Days of the year around a block's place.")] = None,
    nearest: Annotated[int | None, typer.Option("--nearest", min=1, help="Number of best matches to draw from.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Also write the figures to this file (.json).")] = None,
    as_json: AsJson = False,
) -> None:
    """How well generated seasons resemble the real years, beside the limits that a generator must keep."""
    from glbench.resources import write_atomically
    from glbench.weather import SeasonGenerator, load_weather
    from glbench.weather.comparison import resemblance
    from glbench.weather.generator import Blocks

    check_file(out, ".json")
    options: dict[str, Any] = {"shortest": shortest, "longest": longest, "window": window, "nearest": nearest}
    blocks = dataclasses.replace(Blocks(), **{key: value for key, value in options.items() if value is not None})
    generator = SeasonGenerator(load_weather(source), numbers_of(years, "years", _EXAMPLE), blocks)
    outcome = resemblance(generator, start=_date(start), within_days=within_days, days=days, seasons=seasons, seed=seed)
    document = {**asdict(outcome), "accepted": outcome.accepted}
    if out is not None:
        write_atomically(out, json.dumps(document, indent=2, allow_nan=False) + "\n")
    title = f"{seasons} seasons of {console.count(days, 'day')} generated from {', '.join(map(str, outcome.years))} of {source}"
    view = console.table(title, "figure", "value", "limits", "", "the worst", numbers=("value",), fold=("figure", "the worst"))
    for figure in outcome.figures:
        verdict = styled("kept", "green") if figure.within_limits else styled("missed", "bold red")
        mark = Markup(verdict if figure.limits else "")
        view.add(figure.name, figure.text, figure.limits, mark, figure.worst)
    last = console.Line("Every limit is kept." if outcome.accepted else "A limit is missed.")
    console.show(console.View([view, last], document), as_json=as_json)


def _date(text: str) -> dt.date:
    try:
        return dt.date.fromisoformat(text)
    except ValueError as error:
        refuse(f"'{text}' is no date such as 2010-03-01.", WeatherError, error)


def _table(title: str, columns: list[str], padding: int = 1) -> console.Table:
    words = {"name", "station", "period [UTC]", "origin", "SHA-256", "month"}
    below = [column.replace(" [", "\n[") for column in columns]  # the unit below the name
    numbers = [heading for heading, column in zip(below, columns, strict=True) if column not in words]
    look: dict[str, Any] = {"padding": (0, padding, 0, 0), "pad_edge": False, "title_style": None}
    return console.table(title, *below, numbers=numbers, fold=("station", "period\n[UTC]", "origin"), **look)


def description(record: WeatherRecord) -> Iterator[console.Part]:
    """Where a record comes from, a fact a line."""
    from zoneinfo import ZoneInfo

    def degrees(value: float, positive: str, negative: str) -> str:
        return f"{abs(value):.3f} deg {positive if value >= 0 else negative}"

    place, zone = record.place, ZoneInfo(record.timezone)
    moments = (record.last.replace(month=month, day=1).astimezone(zone) for month in (1, 7))
    hours = sorted({(moment.utcoffset() or dt.timedelta()) / dt.timedelta(hours=1) for moment in moments})
    shift = " h or ".join(f"{abs(hour):g}" for hour in hours)
    clock = f"{shift} h {'ahead' if hours[0] >= 0 else 'behind'}{', with summer time' if len(hours) > 1 else ''}"
    where = f"{degrees(place.latitude, 'N', 'S')}, {degrees(place.longitude, 'E', 'W')}, {place.altitude:g} m"
    facts = [
        ("name", record.name),
        ("station", f"{place.station} ({where})"),
        ("clock", f"UTC; the local clock ({place.timezone}) is {clock}"),
        ("period", f"{record.period}, {record.hours:,} h"),
        ("source", record.source),
        ("licence", record.licence),
        ("SHA-256", record.digest),
        *(("note", note) for note in record.notes),
    ]
    for label, text in facts:
        yield console.Line(f"{label:<10} {text}")


def _moment(moment: dt.datetime) -> str:
    """A date, with the hour where it is not midnight."""
    return f"{moment:%Y-%m-%d}" if moment.hour == moment.minute == 0 else f"{moment:%Y-%m-%d %H:%M}"


def _report_saved(record: WeatherRecord, path: Path) -> None:
    from glbench.outside_tables import Check
    from glbench.weather.summary import doubts, in_figures

    check = Check(record.notes, tuple(doubts(record)))
    console.write(f"Weather '{path.stem}': {record.period}, {record.hours:,} h, SHA-256 {record.digest[:12]}, in {path}")
    for note in check.notes:
        console.write(f"Note: {note}")
    for figures in in_figures(record):
        console.write(f"  {figures}")
    console.write(f"The record is {check.verdict}{':' if check.doubts else '.'}")
    console.put_parts(console.paragraph(f"Warning: {doubt}", "yellow", aside=True) for doubt in check.doubts)


def _as_json(one: WeatherInfo | WeatherRecord, *fields: str, **more: object) -> dict[str, Any]:
    """Name and place, the first and the last moment, and these fields."""
    place = one.place
    return {
        "name": one.name, "station": place.station, "latitude_deg": place.latitude, "longitude_deg": place.longitude,
        "altitude_m": place.altitude, "timezone": place.timezone, "first": one.first.isoformat(), "last": one.last.isoformat(),
        **{field: getattr(one, field) for field in fields}, "notes": list(one.notes), **more,
    }  # fmt: skip
