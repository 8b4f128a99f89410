"""``glbench weather``: which weather there is, what it is like, and how to bring in more."""

from __future__ import annotations

import datetime as dt
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from glbench.cli.console import messages, output, put, put_json, table
from glbench.cli.options import AsJson

if TYPE_CHECKING:
    from rich.table import Table

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
_OF_RECORD = ("source", "licence", "digest", "typical_year")

app = typer.Typer(
    help="List, show, import and fetch weather records.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Replace = Annotated[bool, typer.Option("--replace", help="Replace your own record of that name.")]
FillGaps = Annotated[
    int, typer.Option("--fill-gaps", min=0, max=48, help="Fill up to so many missing hours in a row linearly; noted.")
]


@app.command("list")
def list_records(as_json: AsJson = False) -> None:
    """List the shipped weather records and your own."""
    from glbench.weather import list_weather

    infos = list_weather()
    if as_json:
        put_json({"records": [_as_json(info, *_OF_INFO, path=str(info.path)) for info in infos]})
        return
    view = _table("Weather records", ["name", "station", "period [UTC]", "hours [h]", "origin", "SHA-256"])
    for info in infos:
        view.add_row(
            info.name,
            info.place.station,
            f"{_moment(info.first)} to {_moment(info.last)}",
            f"{info.hours:,}",
            info.origin + (", typical year" if info.typical_year else ""),
            info.digest[:8],
        )
    output().print(view)


@app.command("show")
def show(
    name: Annotated[str, typer.Argument(help="Name of a record, as in `glbench weather list`.")],
    month: Annotated[
        str | None, typer.Option("--month", help="Only this month: 2010-03, or 3 for every March.", metavar="MONTH")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show where a record comes from, and its monthly means and sums."""
    from glbench.weather import load_weather
    from glbench.weather.summary import UNITS, monthly

    record = load_weather(name)
    months = monthly(record, month)
    if as_json:
        described = _as_json(record, *_OF_RECORD, timing=dict(record.timing))
        put_json({**described, "units": dict(UNITS), "months": [asdict(row) for row in months]})
        return
    _print_description(record)
    # Where both are known the sky's infrared is what the preprocessings use; the JSON has both.
    sky = ("infrared [W/m2]", "sky_infrared_mean", 1)
    if "sky_infrared" not in record.counts:
        sky = ("cloud [octants]", "cloud_cover_mean", 1)
    columns = (*_MONTHLY, sky)
    # ten columns fit a terminal of 80
    view = _table("Months (UTC)", ["month", *(heading for heading, _, _ in columns)], padding=0)
    for row in months:
        values = [(getattr(row, name), digits) for _, name, digits in columns]
        view.add_row(row.month, *("-" if value is None else f"{value:.{digits}f}" for value, digits in values))
    output().print(view)


@app.command("import")
def import_file(
    file: Annotated[Path, typer.Argument(help="KNMI text or zip, EnergyPlus EPW, NREL TMY2/TMY3, or CSV.")],
    name: Annotated[str, typer.Option("--name", help="Name of the new record: lower-case letters, digits, . _ -")],
    file_format: Annotated[
        str, typer.Option("--format", help="auto, knmi, epw, tmy or csv; auto looks at the content.")
    ] = "auto",
    timezone: Annotated[
        str | None, typer.Option(help="EPW, TMY: IANA zone of the local clock, such as Europe/Amsterdam.")
    ] = None,
    year: Annotated[int | None, typer.Option(help="EPW, TMY: the common year given to a typical year (2001).")] = None,
    station: Annotated[int | None, typer.Option(help="KNMI: number of the station, in a file of several.")] = None,
    fill_gaps: FillGaps = 0,
    replace: Replace = False,
) -> None:
    """Check a weather file and keep it under a name."""
    from glbench.weather import read_weather, save_weather

    record = read_weather(
        file, file_format, name=name, timezone=timezone, year=year, station=station, fill_gaps=fill_gaps
    )
    _report_saved(record, save_weather(record, name, overwrite=replace))


@app.command("fetch")
def fetch(
    station: Annotated[int, typer.Option("--station", help="KNMI's number of the station; 240 is Schiphol.")],
    year: Annotated[int, typer.Option("--year", help="Calendar year (UT).")],
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the new record; knmi-STATION-YEAR by default.")
    ] = None,
    url: Annotated[
        str | None, typer.Option("--url", help="Address of the service.", envvar="GLBENCH_KNMI_URL", show_envvar=True)
    ] = None,
    timeout: Annotated[float, typer.Option("--timeout", min=0.1, help="Longest silence of the service [s].")] = 60.0,
    total_timeout: Annotated[
        float, typer.Option("--total-timeout", min=0.1, help="Longest time of the whole download [s].")
    ] = 600.0,
    refresh: Annotated[
        bool, typer.Option("--refresh", help="Ask the service even if the answer is in the cache.")
    ] = False,
    fill_gaps: FillGaps = 0,
    replace: Replace = False,
) -> None:
    """Download a station and year from KNMI, check it, and keep it under a name."""
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeElapsedColumn

    from glbench.weather import fetch_knmi, save_weather
    from glbench.weather.store import check_new_name

    chosen = name or f"knmi-{station}-{year}"
    check_new_name(chosen, overwrite=replace)
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeElapsedColumn())
    with Progress(*columns, console=messages(), transient=True) as bar:
        task = bar.add_task(f"KNMI station {station}, {year}", total=None)
        record = fetch_knmi(
            station,
            year,
            name=chosen,
            url=url,
            timeout_seconds=timeout,
            total_seconds=total_timeout,
            refresh=refresh,
            fill_gaps=fill_gaps,
            progress=lambda received, total: bar.update(task, completed=received, total=total),
        )
    _report_saved(record, save_weather(record, chosen, overwrite=replace))


def _table(title: str, columns: list[str], padding: int = 1) -> Table:
    words = {"name", "station", "period [UTC]", "origin", "SHA-256", "month"}
    look = {"padding": (0, padding, 0, 0), "pad_edge": False, "title_style": None}
    view = table(title, *columns, right=set(columns) - words, folded=("station", "period [UTC]", "origin"), **look)
    for column in view.columns:
        # The unit stands below the name; as text, not markup: square brackets would be taken for styles.
        column.header = Text(str(column.header).replace(" [", "\n["))
    return view


def _print_description(record: WeatherRecord) -> None:
    place = record.place
    lines = [
        ("name", record.name),
        (
            "station",
            f"{place.station} ({_degrees(place.latitude, 'N', 'S')}, {_degrees(place.longitude, 'E', 'W')}, {place.altitude:g} m)",
        ),
        ("clock", f"UTC; the local clock ({place.timezone}) is {_ahead(record)}"),
        ("period", f"{record.period}, {record.hours:,} h"),
        ("source", record.source),
        ("licence", record.licence),
        ("SHA-256", record.digest),
        *(("note", note) for note in record.notes),
    ]
    for label, text in lines:
        put(f"{label:<10} {text}")


def _ahead(record: WeatherRecord) -> str:
    """How far the local clock is ahead of UTC over the record's last year."""
    from zoneinfo import ZoneInfo

    hours = sorted(
        {
            (
                record.last.replace(month=month, day=1).astimezone(ZoneInfo(record.timezone)).utcoffset()
                or dt.timedelta()
            )
            / dt.timedelta(hours=1)
            for month in (1, 7)
        }
    )
    shift = " h or ".join(f"{abs(hour):g}" for hour in hours)
    return f"{shift} h {'ahead' if hours[-1] >= 0 else 'behind'}{', with summer time' if len(hours) > 1 else ''}"


def _moment(moment: dt.datetime) -> str:
    """A date, with the hour where it is not midnight."""
    return f"{moment:%Y-%m-%d}" if moment.hour == moment.minute == 0 else f"{moment:%Y-%m-%d %H:%M}"


def _degrees(value: float, positive: str, negative: str) -> str:
    return f"{abs(value):.3f} deg {positive if value >= 0 else negative}"


def _report_saved(record: WeatherRecord, path: Path) -> None:
    saved = f"Weather '{path.stem}': {record.period}, {record.hours:,} h, SHA-256 {record.digest[:12]}, in {path}"
    put(saved)
    for note in record.notes:
        put(f"Note: {note}")


def _as_json(one: WeatherInfo | WeatherRecord, *fields: str, **more: object) -> dict[str, Any]:
    """Name and place, the first and the last moment, and these fields."""
    place = one.place
    return {
        "name": one.name,
        "station": place.station,
        "latitude_deg": place.latitude,
        "longitude_deg": place.longitude,
        "altitude_m": place.altitude,
        "timezone": place.timezone,
        "first": one.first.isoformat(),
        "last": one.last.isoformat(),
        **{field: getattr(one, field) for field in fields},
        "notes": list(one.notes),
        **more,
    }
