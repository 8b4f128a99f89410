"""From the rows of an outside file to an hourly record: averages of finer steps, limits of sensors, and an estimated sky.

**Averages.** Rows of 1 to 60 minutes, also those that begin half an hour off the UTC hour (India, Adelaide), become hours by the
time that each row covers of the hour. An hour of which less than half is covered is missing.

**Sensors.** At night a pyranometer reads a few W m-2 below 0, and in fog a hygrometer a little above 100 %: both are set to the limit.

**Sky.** Where there is neither cloud cover nor the sky's infrared radiation nor its temperature, the infrared radiation is estimated
from clearness and humidity after Crawford and Duchon (1999, J. Appl. Meteorol. 38, 474-480):

    L = sigma T^4 (c + (1 - c) 1.24 (e / T)^(1/7))

with the air's temperature T [K] and vapour pressure e [hPa], the emissivity of a clear sky after Brutsaert (1975), and the share of
clouds c = 1 - G / G0 from global radiation over that of a clear sky, here after Haurwitz (1945). At night and with a low sun c runs
linearly from evening to morning. docs/weather.md says how large the error is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glbench.errors import WeatherError, refuse
from glbench.outside_tables import step_of
from glbench.weather import record
from glbench.weather.conserving import sine_of_elevation
from glbench.weather.preprocessing import KELVIN, STEFAN_BOLTZMANN_ENERGYPLUS, vapour_pressure

LOWEST_NIGHT_RADIATION = -25.0  # Radiation [W m-2] that the offset of a pyranometer explains; below it something is wrong
HIGHEST_HUMIDITY = 105.0  # Humidity [%] that the error of a hygrometer explains
LOWEST_COVERAGE = 0.5  # Share of an hour that its rows must cover
LOWEST_SINE = 0.1  # Sine of the sun's elevation above which radiation tells the clouds; 6 degrees
PARTS = 3  # Parts of an hour over which a clear sky is averaged
CLEARNESS_INPUTS = ("air_temperature", "relative_humidity", "global_radiation")
SKY_ESTIMATED = (
    "sky_infrared estimated from clearness and humidity (Crawford and Duchon, 1999), because neither clouds nor the sky were measured; "
    "at Schiphol the sky temperature is then off by 6.1 K (root mean square) from that of observed clouds"
)


def hourly_record(rows: record.Rows, origin: record.Origin, *, fill_gaps: int = 0) -> record.WeatherRecord:
    """Checked hourly record of the rows of an outside file, whatever their step up to an hour, with a sky.

    The arguments are those of ``assemble``, with ``slot_ends`` the end of each row's interval. Raises ``WeatherError`` for rows out of
    order, coarser than an hour, or otherwise as ``assemble`` does.
    """
    present = {name: values for name, values in rows.columns.items() if name in record.REQUIRED or not np.isnan(values).all()}
    rows, notes = _sensors_within_limits(replace(rows, columns=present))
    record.check_values(rows)
    step = step_of(rows.slot_ends)
    backward = np.flatnonzero(np.diff(rows.slot_ends) <= 0)
    if backward.size:
        i = int(backward[0])
        here, before = (record.utc_text(int(rows.slot_ends[k])) for k in (i + 1, i))
        what = f"{here} UTC appears twice" if here == before else f"{here} UTC follows {before} UTC"
        msg = (
            f"{rows.file}, row {rows.row_numbers[i + 1]}: the interval ending {what}. Sort the rows by time, and leave one of each; if it "
            "is the hour that a clock shows twice in autumn, the clock of the stamps is one with summer time, such as Europe/Amsterdam."
        )
        raise WeatherError(msg)
    if step > record.SLOT_SECONDS:
        apart = f"{step / record.SLOT_SECONDS:g} h apart"
        refuse(f"{rows.file}: its rows are {apart}. The model needs a row an hour or finer; export finer values.", WeatherError)
    if step != record.SLOT_SECONDS or rows.slot_ends[0] % record.SLOT_SECONDS:
        rows, averaged = _averaged(rows, step)
        notes += averaged
    if any(name in rows.columns for name in record.SKY) or not all(name in rows.columns for name in record.REQUIRED):
        return record.assemble(rows, replace(origin, notes=(*origin.notes, *notes)), fill_gaps=fill_gaps)
    # An estimate needs every hour of the others: they are checked, and filled where asked, beside a placeholder.
    columns = {**rows.columns, "cloud_cover": np.zeros(rows.slot_ends.size)}
    timing: dict[str, record.Timing] = {**rows.timing, "cloud_cover": "mean", "sky_infrared": rows.timing["air_temperature"]}
    whole = record.assemble(replace(rows, columns=columns, timing=timing), origin, fill_gaps=fill_gaps)
    columns = {name: whole.values(name) for name in record.REQUIRED}
    temperature, humidity, radiation = (whole.values(name) for name in CLEARNESS_INPUTS)
    columns["sky_infrared"] = sky_infrared(temperature, np.maximum(humidity, 1.0), radiation, whole.begin, whole.place)
    ends: record.IntArray = whole.begin + record.SLOT_SECONDS * np.arange(1, whole.hours + 1, dtype=np.int64)
    rows = record.Rows(rows.file, ends, columns, timing, np.arange(whole.hours, dtype=np.int64))
    return record.assemble(rows, replace(origin, notes=(*whole.notes, *notes, SKY_ESTIMATED)))


def clear_sky_radiation(begin: int, hours: int, place: record.Place) -> tuple[record.FloatArray, record.FloatArray]:
    """Global radiation of a clear sky [W m-2], mean of each hour, and the highest sine of the sun's elevation in it ``(hours,)``.

    Haurwitz (1945): 1098 s exp(-0.057 / s), with the sine s. ``begin`` is the start of the first hour [s since 1970-01-01 UTC].
    """
    moments = begin + np.arange(hours * PARTS + 1, dtype=np.float64) * (record.SLOT_SECONDS / PARTS)
    sine = sine_of_elevation(moments, place)
    of_hour = np.stack([sine[part : sine.size - PARTS + part : PARTS] for part in range(PARTS + 1)], axis=1)
    up = np.maximum(of_hour, 1e-6)
    return np.asarray(1098.0 * up * np.exp(-0.057 / up)).mean(axis=1), of_hour.max(axis=1)


def sky_infrared(
    temperature: record.FloatArray, humidity: record.FloatArray, radiation: record.FloatArray, begin: int, place: record.Place
) -> record.FloatArray:
    """Infrared radiation from the sky [W m-2], estimated for each hour ``(hours,)`` after Crawford and Duchon (1999).

    Air temperature [degC], relative humidity [%] and global radiation [W m-2] are of the hours from ``begin`` [s since 1970-01-01 UTC].
    """
    clear, highest_sine = clear_sky_radiation(begin, radiation.size, place)
    lit = np.flatnonzero(highest_sine > LOWEST_SINE)
    # In the polar night nothing tells the clouds: half a sky of them.
    clearness = radiation[lit] / clear[lit] if lit.size else np.array([0.5])
    hours = np.arange(radiation.size)
    cloud = 1.0 - np.clip(np.interp(hours, lit if lit.size else hours[:1], clearness), 0.0, 1.0)
    kelvin = temperature + KELVIN
    emissivity_clear = 1.24 * (vapour_pressure(temperature, humidity) / 100.0 / kelvin) ** (1.0 / 7.0)
    emissivity = cloud + (1.0 - cloud) * np.minimum(emissivity_clear, 1.0)
    return np.asarray(emissivity * STEFAN_BOLTZMANN_ENERGYPLUS * kelvin**4)


def _sensors_within_limits(rows: record.Rows) -> tuple[record.Rows, tuple[str, ...]]:
    """Small readings beyond what is possible set to the limit, with a note."""
    columns, notes = dict(rows.columns), []
    for name, low, high, limit, unit, why in (
        ("global_radiation", LOWEST_NIGHT_RADIATION, 0.0, 0.0, "W/m2", "the offset of a pyranometer at night"),
        ("relative_humidity", 100.0, HIGHEST_HUMIDITY, 100.0, "%", "the error of a hygrometer"),
    ):
        values = columns.get(name, np.empty(0))
        beyond = (values >= low) & (values <= high) & (values != limit)
        if beyond.any():
            extreme = values[beyond][np.argmax(np.abs(values[beyond] - limit))]
            columns[name] = np.where(beyond, limit, values)
            notes.append(f"{name}: {int(beyond.sum()):,} values as far as {extreme:g} {unit} set to {limit:g} {unit} ({why})")
    return replace(rows, columns=columns), tuple(notes)


def _averaged(rows: record.Rows, step: int) -> tuple[record.Rows, tuple[str, ...]]:
    """Hours of rows that cover ``step`` seconds each, and how they came about."""
    starts = np.maximum(rows.slot_ends - step, np.concatenate([[rows.slot_ends[0] - step], rows.slot_ends[:-1]]))
    first_hour = int(starts[0]) // record.SLOT_SECONDS
    hours = -(-int(rows.slot_ends[-1]) // record.SLOT_SECONDS) - first_hour
    hour = starts // record.SLOT_SECONDS - first_hour
    in_first = np.minimum(rows.slot_ends, (hour + first_hour + 1) * record.SLOT_SECONDS) - starts
    in_next = rows.slot_ends - starts - in_first  # a row is at most an hour long
    columns: dict[str, record.FloatArray] = {}
    complete, in_part = np.ones(hours, dtype=bool), np.zeros(hours, dtype=bool)
    for name, values in rows.columns.items():
        valid = ~np.isnan(values)
        total, coverage = np.zeros(hours), np.zeros(hours)
        for index, seconds in ((hour, in_first), (np.minimum(hour + 1, hours - 1), in_next)):
            weight = np.where(valid, seconds, 0)
            np.add.at(total, index, weight * np.where(valid, values, 0.0))
            np.add.at(coverage, index, weight)
        enough = coverage >= LOWEST_COVERAGE * record.SLOT_SECONDS
        columns[name] = np.where(enough, total / np.maximum(coverage, 1.0), np.nan)
        in_part |= enough & (coverage < record.SLOT_SECONDS)
        if name in record.REQUIRED:
            complete &= coverage >= record.SLOT_SECONDS - 1
    inside = slice(int(not complete[0]), hours - int(not complete[-1]))  # the first and the last hour of a file may be there in part
    if inside.start >= inside.stop:
        refuse(f"{rows.file} covers no whole hour with all of {', '.join(record.REQUIRED)}. Export a longer period.", WeatherError)
    ends = (first_hour + np.arange(hours, dtype=np.int64) + 1)[inside] * record.SLOT_SECONDS
    numbers = rows.row_numbers[np.minimum(np.searchsorted(rows.slot_ends, ends), rows.slot_ends.size - 1)]
    what = (
        f"rows of {step / 60:g} min averaged to hours"
        if step < record.SLOT_SECONDS
        else "hours that do not begin with an hour of UTC averaged to those that do"
    )
    notes = [f"{what}; {ends.size:,} h"]
    if in_part[inside].any():
        notes.append(f"{np.count_nonzero(in_part[inside]):,} h are means of an hour with missing rows, of which at least half was there")
    columns = {name: values[inside] for name, values in columns.items()}
    return record.Rows(rows.file, ends, columns, dict.fromkeys(columns, "mean"), numbers), tuple(notes)
