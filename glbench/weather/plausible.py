"""What a person checks after an import: a record in a few figures, and whether its radiation fits the sun over its station."""

from __future__ import annotations

import numpy as np

from glbench.weather.conserving import TWILIGHT_SINE, sine_of_elevation
from glbench.weather.record import SLOT_SECONDS, FloatArray, WeatherRecord
from glbench.weather.summary import PHOTONS_PER_JOULE

DAY_HOURS = 24
DARK_RADIATION = 10.0
"""Radiation [W m-2] that no sun gives in an hour that lies wholly in the night; an idle sensor may be off by a few."""
FEW_HOURS = 5
"""So many such hours say that something is wrong."""
CLOCK_DAYS, LEVEL_DAYS = 30, 10
"""Shortest records [d] that are compared with the course and with the level of a clear sky. In the shipped records no stretch of this
length gives a warning."""
HIGH_SUN = float(np.sin(np.radians(10.0)))
BRIGHTEST_LOW, USUAL_HIGH = 0.5, 1.45
"""Limits of the radiation over that of a clear sky, in hours of high sun: 2 % of them exceed the first even in ten dull days, and nine
tenths stay below the second."""
_PARTS = 3


def in_figures(record: WeatherRecord) -> list[str]:
    """Figures of the whole record, one a line, for comparison with a climate table."""
    temperature = record.values("air_temperature")
    radiation = float(record.values("global_radiation").mean()) * DAY_HOURS * SLOT_SECONDS
    wind = record.values("wind_speed")
    return [
        f"air temperature: lowest {temperature.min():.1f} degC, mean {temperature.mean():.1f} degC, highest {temperature.max():.1f} degC",
        f"light, mean of a day: {radiation * 1e-4:.0f} J/cm2 of global radiation, {radiation * PHOTONS_PER_JOULE * 1e-6:.1f} mol/m2 of PAR",
        f"wind: mean {wind.mean():.1f} m/s, highest {wind.max():.1f} m/s",
    ]


def doubts(record: WeatherRecord) -> list[str]:
    """What about the radiation does not fit the sun over the station, one a sentence or two; empty when nothing does."""
    moments = record.begin + np.arange(record.hours * _PARTS + 1, dtype=np.float64) * (SLOT_SECONDS / _PARTS)
    sine = sine_of_elevation(moments, record.place)
    of_slot = np.stack([sine[part : sine.size - _PARTS + part : _PARTS] for part in range(_PARTS + 1)], axis=1)
    radiation, highest = record.values("global_radiation"), of_slot.max(axis=1)
    clear = _under_a_clear_sky(of_slot)
    at_night = int(np.count_nonzero((highest < -TWILIGHT_SINE) & (radiation > DARK_RADIATION)))
    late = _hours_late(radiation, clear)
    if at_night >= FEW_HOURS or (late != 0 and record.hours >= CLOCK_DAYS * DAY_HOURS):
        return [_clock_in_words(record, at_night, late)]
    high = highest > HIGH_SUN
    if record.hours < LEVEL_DAYS * DAY_HOURS or not high.any():
        return []
    share = radiation[high] / clear[high]
    brightest, usual = np.quantile(share, 0.98), np.quantile(share, 0.9)
    if brightest < BRIGHTEST_LOW:
        return [
            f"radiation is low: with a high sun, 98 % of the hours have less than {100 * brightest:.0f} % of what a clear sky gives. "
            "Is it in the unit of the column's title? J/cm2 taken for W/m2 makes it 0.36 of what it is."
        ]
    if usual > USUAL_HIGH:
        return [
            f"radiation is high: with a high sun, one hour in ten has more than {100 * usual:.0f} % of what a clear sky gives. "
            "Is it in the unit of the column's title? W/m2 taken for J/cm2 makes it 2.8 times what it is."
        ]
    return []


def _clock_in_words(record: WeatherRecord, at_night: int, late: int) -> str:
    found = [f"sun at night in {at_night} hours (more than {DARK_RADIATION:g} W/m2 in the dark)"] if at_night else []
    if late:
        found.append(f"the radiation is {abs(late)} h {'late' if late > 0 else 'early'} for the sun")
    return (
        f"{'; '.join(found)}, at {record.latitude:g} deg north, {record.longitude:g} deg east. Are the stamps local time instead of UTC, "
        "or the coordinates of another place? Write local stamps with their offset, such as 2024-05-01T03:00+02:00."
    )


def _under_a_clear_sky(sine: FloatArray) -> FloatArray:
    """Global radiation [W m-2] of each slot under a clear sky, after Haurwitz (1945), from sines of the elevation ``(slots, moments)``."""
    up = np.maximum(sine, 1e-6)
    clear: FloatArray = np.asarray(1098.0 * up * np.exp(-0.057 / up)).mean(axis=1)
    return clear


def _hours_late(radiation: FloatArray, clear: FloatArray) -> int:
    """By how many hours, -12 to 12, the course of a clear sky has to be late to fit the radiation best."""
    shifts = range(-DAY_HOURS // 2, DAY_HOURS // 2 + 1)
    return max(shifts, key=lambda shift: (float(radiation @ np.roll(clear, shift)), -abs(shift)))
