"""The climate inside a compartment every five minutes: the air, what the actuators did, and the set points that were realised.

``read_indoor`` reads ``GreenhouseClimate.csv`` or ``.parquet`` of the published archive, or ``indoor.csv`` of a greenhouse's own export.
Readings that cannot be true are taken out and noted, never used: those outside what a sensor or an actuator can say (an error code such as
-499), those far from all others of the hours around them, both sides of a jump that nothing explains, and values stuck for hours.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ArchiveError
from glbench.realism.export import EXPORT, WEATHER_UNITS, read_export
from glbench.realism.published import DAY_ZERO, ROW_SECONDS, ROWS_A_DAY, day_of, five_minutes, moment, on_rows, read_rows
from glbench.weather.record import FloatArray, IntArray

AROUND = 12  # Readings before and after one, with which it is compared: an hour each
LONGEST_SAME = 72  # Readings of a sensor, 6 h, that may be the same
MOST_LOST = 0.05  # Share of a sensor's readings beyond which losing them is a doubt
FEW_DAYS = 28  # Days below which an export says little about a house
LONGEST_HELD = 12  # Missing readings of a pipe, 1 h, for which the last one holds; later it counts as off
HPS_POWER = 81.0  # Electric power of the archive's HPS lamps [W m-2]
LED_POWER: Mapping[str, float] = MappingProxyType({"blue": 7.27, "red": 25.3, "farred": 6.23, "white": 22.72})
"""Most electric power of the channels of the archive's LEDs [W m-2], at 1000; they burn only while the HPS lamps do."""


@dataclass(frozen=True)
class Quantity:
    """What a column of the indoor climate holds.

    It can be from ``low`` to ``high``; of each row counts the first of the columns ``archive`` that has a value. ``leap`` is how far a
    sensor's reading can be from the median of two hours around it, and from the one five minutes before.
    """

    unit: str
    meaning: str
    low: float
    high: float
    archive: tuple[str, ...]
    leap: float | None = None


def _set_point(unit: str, meaning: str, high: float, name: str) -> Quantity:
    return Quantity(unit, f"set point: {meaning}", 0.0, high, (f"{name}_vip", f"{name}_sp"))


INDOOR: Mapping[str, Quantity] = MappingProxyType(
    {
        "air_temperature": Quantity("degC", "temperature of the air", 1.0, 60.0, ("Tair",), leap=7.0),
        "humidity": Quantity("%", "relative humidity", 1.0, 100.0, ("Rhair",), leap=25.0),
        "co2": Quantity("ppm", "CO2 of the air", 100.0, 5000.0, ("CO2air",), leap=700.0),
        "vents_lee": Quantity("%", "lee vents, open", 0.0, 100.0, ("VentLee",)),
        "vents_wind": Quantity("%", "windward vents, open", 0.0, 100.0, ("Ventwind",)),
        "thermal_screen": Quantity("%", "energy screen, closed", 0.0, 100.0, ("EnScr",)),
        "blackout_screen": Quantity("%", "blackout screen, closed", 0.0, 100.0, ("BlackScr",)),
        "lamps": Quantity("W/m2", "lamps, electric power", 0.0, 500.0, ("AssimLight",)),
        "rail_pipe": Quantity("degC", "rail pipe, empty or 0 where it is off", 0.0, 110.0, ("PipeLow",)),
        "grow_pipe": Quantity("degC", "growing pipe, empty or 0 where it is off", 0.0, 110.0, ("PipeGrow",)),
        "co2_dose": Quantity("kg/m2/h", "CO2 dosed", 0.0, 0.2, ("co2_dos",)),
        "heating_set_point": _set_point("degC", "heat below", 50.0, "t_heat"),
        "ventilation_lee_set_point": _set_point("degC", "open lee vents above", 60.0, "t_ventlee"),
        "ventilation_wind_set_point": _set_point("degC", "open windward vents above", 60.0, "t_ventwind"),
        "humidity_deficit_set_point": _set_point("g/m3", "least humidity deficit", 20.0, "dx"),
        "minimum_rail_pipe": _set_point("degC", "least temperature of the rail pipe", 90.0, "t_rail_min"),
        "minimum_grow_pipe": _set_point("degC", "least temperature of the growing pipe", 90.0, "t_grow_min"),
        "minimum_vents": _set_point("%", "least opening of the lee vents", 100.0, "window_pos_lee"),
        "co2_set_point": _set_point("ppm", "dose CO2 below", 3000.0, "co2"),
        # of the screens `_vip` is how far they may close, `_sp` where they should be
        "thermal_screen_set_point": Quantity("%", "set point: energy screen, closed", 0.0, 100.0, ("scr_enrg_sp",)),
        "blackout_screen_set_point": Quantity("%", "set point: blackout screen, closed", 0.0, 100.0, ("scr_blck_sp",)),
    }
)
"""The columns by name."""
REQUIRED = ("air_temperature", "humidity", "vents_lee", "vents_wind", "rail_pipe")
REQUIRED_OF_EXPORT = tuple(name for name in REQUIRED if name != "vents_wind")
PIPES, SENSORS = ("rail_pipe", "grow_pipe"), ("air_temperature", "humidity", "co2")


@dataclass(frozen=True, eq=False)
class Indoor:
    """Indoor climate of a compartment.

    ``times`` are seconds since 1970 UTC (rows,), every five minutes from the midnight before the first day to the one after the last: what
    was read then holds for five minutes. ``columns`` are all of ``INDOOR`` (rows,), NaN where nothing was measured, the reading cannot be
    true, or a pipe is off. ``lamp_power`` is what is installed [W m-2], ``notes`` say what was taken out or filled, ``doubts`` what needs a
    person's eye before the climate is used.
    """

    name: str
    times: IntArray
    columns: Mapping[str, FloatArray]
    lamp_power: float
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def read_indoor(
    path: Path, clock: str = "Europe/Amsterdam", *, first: dt.date | None = None, days: int | None = None, lamp_power: float | None = None
) -> Indoor:
    """Read the indoor climate of a compartment: ``GreenhouseClimate`` (.csv, .parquet) of the archive, or ``indoor.csv`` of an export.

    ``clock`` is the IANA zone of its stamps: the hour that summer time skips does not exist; the hour that comes twice is read twice, of an
    export in its order. ``first`` and ``days`` are those to read; by default all that the file has. ``lamp_power`` is the installed
    electric power [W m-2] of an export's lamps, where they come in per cent; by default the most that they took. Raises ``ArchiveError``,
    with file, row and column, when the file cannot be read, lacks a column of ``REQUIRED``, or has a text for a number.
    """
    if path.name == EXPORT:
        return _indoor_of_export(path, clock, first, days, lamp_power)
    sheet, rows = read_rows(path)

    def first_of(names: Sequence[str]) -> FloatArray:
        values = np.full(rows.size, np.nan)
        for name in (name for name in names if name in sheet.table):
            values = np.where(np.isnan(values), sheet.numbers(name), values)
        return values

    columns = {name: first_of(quantity.archive) for name, quantity in INDOOR.items()}
    for name in REQUIRED:
        if np.all(np.isnan(columns[name])):
            quantity = INDOOR[name]
            msg = f"{path} has no values in a column '{quantity.archive[0]}' ({quantity.meaning}, {quantity.unit}), which is needed."
            raise ArchiveError(msg)
    burning, columns["lamps"] = columns["lamps"] > 0.0, HPS_POWER / 100.0 * columns["lamps"]
    for channel, most in LED_POWER.items():
        share = np.clip(np.nan_to_num(first_of((f"int_{channel}_vip", f"int_{channel}_sp"))), 0.0, 1000.0) / 1000.0
        columns["lamps"] += np.where(burning, most * share, 0.0)
    first = first or day_of(rows[0] // ROWS_A_DAY)
    days = days or int(rows[-1] - 1) // ROWS_A_DAY + 1 - (first - DAY_ZERO).days
    times, numbers = five_minutes(first, days, clock)
    name = path.parent.name if path.stem.lower() == "greenhouseclimate" else path.stem[: path.stem.lower().rindex("_greenhouse")]
    on_grid = {name: on_rows(values, rows, numbers) for name, values in columns.items()}
    return indoor_of(name, times, numbers, on_grid, HPS_POWER + sum(LED_POWER.values()))


def _indoor_of_export(path: Path, clock: str, first: dt.date | None, days: int | None, lamp_power: float | None) -> Indoor:
    """Of ``indoor.csv``. One column of vents stands for both sides; lamps [%] are turned into power."""
    export = read_export(path, WEATHER_UNITS | {name: quantity.unit for name, quantity in INDOOR.items()}, clock, lamp_power)
    for name in REQUIRED_OF_EXPORT:
        export.need(name, INDOOR[name].unit, INDOOR[name].meaning)
    if first is None or days is None:
        first, days = export.whole_days(clock)
    times, numbers = five_minutes(first, days, clock)
    columns, notes = {name: export.on(times, name) for name in INDOOR}, export.notes
    if "vents_wind" not in export.columns:
        columns["vents_wind"] = columns["vents_lee"]
        notes = (*notes, f"{path.name}: there is no vents_wind; vents_lee counts for both sides.")
    most = float(np.max(columns["lamps"], initial=0.0, where=columns["lamps"] <= INDOOR["lamps"].high))
    power = most if lamp_power is None else lamp_power
    if most > power * (1.0 + 1e-6):
        msg = f"{path}: the lamps take up to {most:g} W/m2, the settings have {power:g} W/m2. Correct [lamps] there, or the file."
        raise ArchiveError(msg)
    indoor = indoor_of(path.resolve().parent.name, times, numbers, columns, power)
    lost = {name: float(np.mean(np.isnan(indoor.columns[name]) & ~np.isnan(columns[name]))) for name in SENSORS}
    bad = [name for name in SENSORS if lost[name] > MOST_LOST]
    doubts = [f"{lost[name]:.0%} of the readings of {name} were taken out: check the sensor" for name in bad]
    if np.all(np.isnan(indoor.columns["co2"])):
        doubts.append("co2 was not measured: photosynthesis and vents are compared by temperature and humidity alone")
    if days < FEW_DAYS:
        doubts.append(f"{days} whole day{'s are' if days > 1 else ' is'} few: {FEW_DAYS} and more tell the house from the weather")
    return replace(indoor, notes=(*notes, *indoor.notes), doubts=tuple(doubts))


def indoor_of(name: str, times: IntArray, numbers: IntArray, columns: Mapping[str, FloatArray], lamp_power: float) -> Indoor:
    """An indoor climate without the readings that cannot be true; ``numbers`` are those of the five minutes on the local clock (rows,)."""
    import pandas as pd

    notes, missing, clean = list[str](), dict[tuple[int, int], list[str]](), dict[str, FloatArray]()
    for column, quantity in INDOOR.items():
        values = columns[column].copy()
        gaps = np.flatnonzero(np.isnan(values))
        if gaps.size:
            missing.setdefault((gaps.size, int(gaps[0])), []).append(column)
        wrong = (values < quantity.low) | (values > quantity.high)
        bad = {f"outside {quantity.low:g} to {quantity.high:g} {quantity.unit}": wrong}
        if quantity.leap is not None:
            leaps = _leaps(quantity.leap, np.where(wrong, np.nan, values))
            rest = np.where(wrong | leaps, np.nan, values)
            lengths = np.diff(np.flatnonzero(np.concatenate(([True], rest[1:] != rest[:-1], [True]))))
            stuck = np.repeat(lengths >= LONGEST_SAME, lengths)
            bad["impossible beside the readings around"] = leaps
            bad[f"the same for {LONGEST_SAME * ROW_SECONDS // 3600} h or longer"] = stuck
            wrong = wrong | leaps | stuck
        for place in np.flatnonzero(wrong)[:1]:
            reasons = ", ".join(f"{one.sum():,} {reason}" for reason, one in bad.items() if one.any())
            number = f"{wrong.sum():,} reading{'' if wrong.sum() == 1 else 's'}"
            notes.append(
                f"{name}, {column}: {number} taken out ({reasons}), the first {values[place]:g} {quantity.unit} at "
                f"{moment(numbers[place])}."
            )
        values[wrong] = np.nan
        if column in PIPES:
            values = np.array(pd.Series(values).ffill(limit=LONGEST_HELD).where(lambda pipe: pipe > 0.0), dtype=np.float64)
        clean[column] = values
    for (count, place), names in missing.items():
        what = "there is no" if count == times.size else f"{count:,} of {times.size:,} rows, the first at {moment(numbers[place])}, have no"
        notes.append(f"{name}: {what} {', '.join(names)}.")
    return Indoor(name, times, MappingProxyType(clean), lamp_power, tuple(notes))


def _leaps(leap: float, values: FloatArray) -> NDArray[np.bool_]:
    """Which readings of a sensor are farther than ``leap`` from the median around them, or on either side of such a jump."""
    from scipy.ndimage import median_filter

    wrong = np.zeros(values.size, dtype=bool)
    present = np.flatnonzero(~np.isnan(values))
    far = np.abs(values[present] - median_filter(values[present], 2 * AROUND + 1, mode="nearest")) > leap
    wrong[present[far]] = True
    present = present[~far]
    jump = (np.abs(np.diff(values[present])) > leap) & (np.diff(present) == 1)
    wrong[present[:-1][jump]] = wrong[present[1:][jump]] = True
    return wrong
