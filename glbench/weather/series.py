"""The ten disturbances of the greenhouse model, for any start, length and control step, from an hourly weather record.

Row k is the weather that acts during step k. The digest of a result covers the canonical whole numbers that were read, the
preprocessing's name and version, and the window asked for. It does not cover the computed floats: ``exp`` and ``sin`` may
differ in the last bit between processors, and a digest must not.
"""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

import numpy as np
import numpy.typing as npt

from glbench.errors import UnknownNameError, WeatherError, did_you_mean, refuse
from glbench.weather.preprocessing import Prepared, Window, clock_time, to_utc_seconds
from glbench.weather.record import SCHEMA, FloatArray, WeatherRecord, canonical_digest, utc_text
from glbench.weather.trace import FILE_DIGEST, WeatherTrace

PREPROCESSINGS = ("paper", "conserving")
"""Of hourly records: ``paper`` repeats the published pipeline; ``conserving`` puts every value at its right time and keeps hourly sums."""
SAMPLED = "sampled"
"""Of traces: the sample nearest to the start of each step."""


@dataclass(frozen=True, eq=False)
class Disturbances:
    """Weather acting on each control step; all arrays are read-only."""

    values: FloatArray
    """``(steps, 10)``: iGlob [W m-2], tOut [degC], vpOut [Pa], co2Out [mg m-3], wind [m s-1], tSky [degC], tSoOut [degC],
    dayRadSum [MJ m-2 d-1], isDay [-], isDaySmooth [-]."""
    times: npt.NDArray[np.datetime64]
    """Start of every step ``(steps,)``, UTC."""
    hour_of_day: FloatArray
    """``(steps,)``, 0..24 h on the clock of the preprocessing: UTC for ``paper``, that of the record for the others."""
    day_of_year: FloatArray
    """``(steps,)``, days since 1 January 00:00 of the same year on that clock, 0 to 365 (366 in a leap year)."""
    digest: str
    """SHA-256 [hex] over the canonical hourly figures used and the window; the same on every machine."""
    preprocessing: str
    """One of ``PREPROCESSINGS``, or ``SAMPLED``."""


def disturbances(
    record: WeatherRecord,
    *,
    start: dt.datetime | dt.date,
    steps: int,
    step_seconds: float = 900.0,
    preprocessing: str = "paper",
    co2_ppm: float = 400.0,
) -> Disturbances:
    """Disturbances for ``steps`` control steps of ``step_seconds`` from ``start``.

    Raises ``UnknownNameError`` when there is no such preprocessing, and ``WeatherError`` when the window is not inside the record's period,
    the preprocessing is not one for the record, or an argument is impossible.

    ``record`` is from ``load_weather`` or one of the readers. ``start`` is that of the first step. A date, or a datetime without time zone,
    is read on the clock of the preprocessing (UTC for ``paper``, else that of the record), so that ``hour_of_day[0]`` is the hour asked
    for. There are ``steps`` rows, at least 1, each of ``step_seconds``, a whole number from 1 to 86400 [s]. ``preprocessing`` is one of
    ``PREPROCESSINGS``; ``SAMPLED`` for a trace. ``co2_ppm`` is the CO2 outside [ppm]; a trace has its own.
    """
    if preprocessing not in (*PREPROCESSINGS, SAMPLED):
        refuse(f"There is no weather preprocessing '{preprocessing}'.{did_you_mean(preprocessing, PREPROCESSINGS)}", UnknownNameError)
    if not isinstance(record, WeatherRecord):
        refuse(f"Disturbances are made of a weather record; got {record!r}. `load_weather` takes one by its name.", WeatherError)
    if isinstance(record, WeatherTrace) != (preprocessing == SAMPLED):
        kind, use = ("a trace", "'sampled'") if isinstance(record, WeatherTrace) else ("an hourly record", "'paper' or 'conserving'")
        refuse(f"Weather '{record.name}' is {kind}, which is not prepared as '{preprocessing}': choose {use}.", WeatherError)
    if not isinstance(start, dt.date):
        refuse(f"The start is a datetime.date or datetime.datetime; got {start!r}.", WeatherError)
    clock = "UTC" if preprocessing == "paper" else record.timezone
    if not 1 <= step_seconds <= 86400 or step_seconds != int(step_seconds):
        refuse(f"The control step must be a whole number of seconds from 1 to 86400, not {step_seconds!r} s.", WeatherError)
    if steps < 1 or steps != int(steps):
        refuse(f"Weather was asked for {steps!r} steps; ask for a whole number, at least 1.", WeatherError)
    if not (math.isfinite(co2_ppm) and 0.0 <= co2_ppm <= 5000.0):
        refuse(f"CO2 outside must lie between 0 and 5000 ppm, not {co2_ppm!r} ppm.", WeatherError)
    window = Window(to_utc_seconds(start, clock), int(steps), int(step_seconds), float(co2_ppm))
    _check_period(record, window)
    prepared: Prepared = _pipeline(preprocessing).prepare(record, window)
    hour_of_day, day_of_year = clock_time(window, clock)
    times = window.times.astype("datetime64[s]")
    for array in (prepared.values, times, hour_of_day, day_of_year):
        array.setflags(write=False)
    digest = _digest(record, window, prepared, preprocessing)
    return Disturbances(prepared.values, times, hour_of_day, day_of_year, digest, preprocessing)


def _pipeline(preprocessing: str) -> ModuleType:
    """The module of a preprocessing; one that nobody asks for is not imported."""
    return import_module(f"glbench.weather.{'trace' if preprocessing == SAMPLED else preprocessing}")


def _check_period(record: WeatherRecord, window: Window) -> None:
    before, after = record.begin - window.start, window.end - record.end
    if before <= 0 and after <= 0:
        return
    missing = [
        f"{seconds / 86400:.2f} days {where} are missing"
        for seconds, where in ((before, "before its beginning"), (after, "after its end"))
        if seconds > 0
    ]
    msg = (
        f"Weather '{record.name}' covers {record.period}, but {utc_text(window.start)} to {utc_text(window.end)} UTC was "
        f"asked for ({window.steps} steps of {window.step} s): {' and '.join(missing)}. Choose a start inside the period or "
        "fewer steps, or get more weather with `glbench weather fetch` or `glbench weather import`."
    )
    raise WeatherError(msg)


def _digest(record: WeatherRecord, window: Window, prepared: Prepared, preprocessing: str) -> str:
    first, last = prepared.first_slot, prepared.last_slot
    header: dict[str, object] = {
        "schema": SCHEMA,
        "preprocessing": preprocessing,
        "version": _pipeline(preprocessing).VERSION,
        "start": window.start,
        "steps": window.steps,
        "step_seconds": window.step,
        "co2_ppm": window.co2_ppm,
        "first_slot_start": record.begin + 3600 * first,
    }
    if isinstance(record, WeatherTrace):
        header["file"] = FILE_DIGEST
    if preprocessing == "conserving":
        # Only this one looks at the sun, the local clock and the moment of each value.
        header["place"] = [record.latitude, record.longitude, record.altitude, record.timezone]
        header["timing"] = dict(record.timing)
    return canonical_digest(header, {name: counts[first:last] for name, counts in sorted(record.counts.items())})
