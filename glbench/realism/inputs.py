"""Inputs of a simulated season: the measured weather as disturbances, and the hours in which the measured light and CO2 are supplied.

The archive's sums do not say at which hours. Lamps burn at full power: at the low tariff in the hours before the high one begins, and
then before midnight; at the high tariff from its beginning, first in light below a limit, then in the dimmest light that is left. CO2 is
dosed evenly while there is light from sun or lamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ArchiveError
from glbench.realism.export import WEATHER_UNITS
from glbench.realism.houses import Lamps, Settings
from glbench.realism.published import ROW_SECONDS, WEATHER, Archive, Compartment, five_minutes, longest, moment, on_rows
from glbench.weather import preprocessing
from glbench.weather.record import FloatArray, IntArray

STEP_SECONDS = 900  # Length of a step [s]: that of the benchmark's tasks
LONGEST_GAP_HOURS = 3  # Weather that may be missing at once [h]
_DAY_SECONDS = 86400
_KWH = 3.6e6  # J
_STEPS_AN_HOUR = 3600 // STEP_SECONDS
DAY, PRE_NIGHT, NIGHT = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Outdoors:
    """What acts in each step from outside: disturbances ``values`` in the model's order (steps, 10).

    Beside them are the number of the step's ``day``, from 0 at the first (steps,), the ``hour`` on the local clock at its start [h]
    (steps,), and what was filled.
    """

    values: FloatArray
    day: IntArray
    hour: FloatArray
    notes: tuple[str, ...]

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.day.size

    def of(self, name: str) -> FloatArray:
        """A column by its public name (steps,)."""
        return self.values[:, preprocessing.COLUMNS.index(name)]


def outdoors(archive: Archive, clock: str, co2_ppm: float, step_seconds: int = STEP_SECONDS) -> Outdoors:
    """Weather over the days of the archive, from midnight to midnight on ``clock``, with ``co2_ppm`` outside.

    What was read at a time holds for the five minutes after it; a step, of a multiple of five minutes, has their means. Gaps are filled
    linearly. The hour that summer time skips does not exist, whatever the archive has in its rows; the hour that comes twice is read twice.

    The sky's temperature follows from the net long-wave radiation of the pyrgeometer, whose own temperature is the air's:
    sigma Tsky^4 = sigma Tout^4 + Pyrgeo. Raises ``ArchiveError`` when more than ``LONGEST_GAP_HOURS`` are missing at once.
    """
    readings, numbers = five_minutes(archive.first, archive.days, clock)
    radiation, temperature, humidity, wind, net = (
        one if archive.own else on_rows(one, archive.weather.rows, numbers) for one in map(archive.weather.columns.__getitem__, WEATHER)
    )
    missing = np.isnan(radiation + temperature + humidity + wind + net)
    notes, present, source = tuple[str, ...](), np.flatnonzero(~missing), archive.weather.source
    if missing.any():
        begin, length = longest(missing)
        hours, when = length * ROW_SECONDS / 3600.0, moment(numbers[begin])
        if hours > LONGEST_GAP_HOURS:
            msg = (
                f"{source}: the weather of {hours:.1f} h is missing from {when}; at most {LONGEST_GAP_HOURS} h are filled. Complete "
                f"{', '.join(WEATHER_UNITS if archive.own else WEATHER)} there, or cut the compartments' days."
            )
            raise ArchiveError(msg)
        rows = f"{missing.sum():,} of {missing.size:,} rows"
        notes = (f"{source.name}: {rows} filled linearly; the longest gap, {length * 5} min, begins {when}.",)
    radiation, temperature, humidity, wind, net = (
        np.interp(np.arange(values.size), present, values[present]) for values in (radiation, temperature, humidity, wind, net)
    )
    sky = preprocessing.STEFAN_BOLTZMANN * (temperature + preprocessing.KELVIN) ** 4 + net
    vapour = preprocessing.vapour_pressure(temperature, np.minimum(humidity, 100.0))
    radiation, temperature, vapour, wind, sky = (
        values.reshape(-1, step_seconds // ROW_SECONDS).mean(axis=1)
        for values in (np.maximum(radiation, 0.0), temperature, vapour, wind, sky)
    )
    times = readings[:: step_seconds // ROW_SECONDS]
    local = times + preprocessing.utc_offsets(times, clock)
    day = local // _DAY_SECONDS - int(local[0] // _DAY_SECONDS)
    sums = np.bincount(day, weights=radiation) * step_seconds * 1e-6
    light = (radiation > 0.0).astype(np.float64)
    columns = {
        "iGlob": radiation,
        "tOut": temperature,
        "vpOut": vapour,
        "co2Out": preprocessing.co2_density(temperature, co2_ppm),
        "wind": wind,
        "tSky": (sky / preprocessing.STEFAN_BOLTZMANN) ** 0.25 - preprocessing.KELVIN,
        "tSoOut": preprocessing.soil_temperature(preprocessing.seconds_into_year(times.astype(np.float64))),
        # The last three serve controllers only; no equation of the model reads them.
        "dayRadSum": sums[day],
        "isDay": light,
        "isDaySmooth": light,
    }
    values = np.column_stack([columns[name] for name in preprocessing.COLUMNS])
    return Outdoors(values, day, (local % _DAY_SECONDS) / 3600.0, notes)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Supplies and set points of every step, all (steps, compartments).

    ``lamps`` are shares of the installed power, ``dose`` is CO2 [mg m-2 s-1], ``period`` is ``DAY``, ``PRE_NIGHT`` or ``NIGHT``. Set points
    are temperatures [degC], the humidity deficit [g m-3], and the outdoor temperature below which the screen closes [degC].
    """

    lamps: FloatArray
    dose: FloatArray
    period: NDArray[np.int64]
    heating: FloatArray
    ventilation: FloatArray
    humidity_deficit: FloatArray
    outdoor: FloatArray


def schedule(
    compartments: tuple[Compartment, ...], outside: Outdoors, settings: Settings, *, most_co2: float, warmer: float = 0.0
) -> Schedule:
    """The schedule of these compartments, with ``warmer`` [K] added to all temperatures of heating and ventilation.

    A day that asks for more CO2 than the installed ``most_co2`` [mg m-2 s-1] gets so much.
    """
    radiation = outside.of("iGlob")
    sunlit = radiation >= settings.periods.dark_below
    lamps = np.column_stack([lamp_shares(one, outside, settings.lamps) for one in compartments])
    lit = sunlit[:, None] | (lamps > 0.0)
    dose = np.column_stack([np.minimum(co2_dose(one.co2, outside, lit[:, i]), most_co2) for i, one in enumerate(compartments)])
    period = periods(lit, settings.periods.pre_night)
    heat, vents = settings.heating, settings.ventilation
    bright = np.clip((last_hour(radiation) - heat.light_from) / (heat.light_full - heat.light_from), 0.0, 1.0)
    bright_day = np.where(period == DAY, bright[:, None], 0.0)
    heating = np.choose(period, (heat.day, heat.pre_night, heat.night)) + heat.light_raise * bright_day + warmer
    above = np.where(period == DAY, vents.day, vents.night) + vents.light_raise * bright_day
    deficit, screen = settings.humidity_deficit, settings.screen
    return Schedule(
        lamps,
        dose,
        period,
        heating,
        heating + above,
        np.where(period == DAY, deficit.day, deficit.night),
        np.where(period == DAY, screen.outdoor_day, screen.outdoor_night),
    )


def lamp_shares(one: Compartment, outside: Outdoors, lamps: Lamps) -> FloatArray:
    """Share of the installed power in every step (steps,), so that each day's electricity at each tariff is the measured one.

    A day that asks for more than all lamps give in those hours gets all of them.
    """
    radiation, hour = outside.of("iGlob"), outside.hour
    shares = np.zeros(outside.steps)
    at_high = (hour >= lamps.high_from) & (hour < lamps.high_until)
    # The lower the rank the sooner a step is lit.
    bright = np.where(radiation < lamps.radiation_limit, 0.0, radiation)
    before = hour < lamps.high_from
    from_the_beginning_back = np.where(before, lamps.high_from - hour, 100.0 + hour)
    a_step = lamps.power * STEP_SECONDS / _KWH
    for number, (high, low) in enumerate(zip(one.high.tolist(), one.low.tolist(), strict=True)):
        today = outside.day == number
        for energy, window, ranks in ((high, today & at_high, (hour, bright)), (low, today & ~at_high, (from_the_beginning_back,))):
            steps = np.flatnonzero(window)
            order = steps[np.lexsort(tuple(rank[steps] for rank in ranks))]
            shares[order] = np.clip(energy / a_step - np.arange(order.size), 0.0, 1.0)
    return shares


def co2_dose(daily: FloatArray, outside: Outdoors, lit: NDArray[np.bool_]) -> FloatArray:
    """CO2 [mg m-2 s-1] in every step (steps,): each day's [kg m-2] evenly over its light, or over all of a day without light."""
    days = daily.size
    light = np.bincount(outside.day[lit], minlength=days)
    dosed = lit | (light == 0)[outside.day]
    return np.where(dosed, (1e6 * daily / (np.bincount(outside.day[dosed], minlength=days) * STEP_SECONDS))[outside.day], 0.0)


def periods(lit: NDArray[np.bool_], pre_night_hours: float) -> NDArray[np.int64]:
    """Period of every step from the light in it, both (steps, compartments). Before the first light it is night."""
    steps = np.arange(lit.shape[0])[:, None]
    last_lit = np.maximum.accumulate(np.where(lit, steps, -lit.shape[0]), axis=0)
    dark = (steps - last_lit - 1) / _STEPS_AN_HOUR  # h since dark fell
    return np.where(lit, DAY, np.where((last_lit >= 0) & (dark < pre_night_hours), PRE_NIGHT, NIGHT)).astype(np.int64)


def last_hour(values: FloatArray) -> FloatArray:
    """Mean of the hour that ends with each step (steps,); of less at the beginning."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    ends = np.arange(1, values.size + 1)
    begins = np.maximum(ends - _STEPS_AN_HOUR, 0)
    return np.asarray((total[ends] - total[begins]) / (ends - begins))
