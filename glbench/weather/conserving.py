"""The preprocessing ``conserving``: every value at its right time, and every hour's mean kept.

- An **instant** at the end of a slot (temperature, vapour pressure, cloud) runs linearly to the end of the next slot.
- A **mean** over a slot (wind) is held through the slot.
- **Radiation** follows the sun within the hour: G(t) = kappa(t) max(sin beta, 0) with beta the geometric solar elevation and
  kappa the clearness, linear between the slots' middles, scaled so that each hour keeps exactly its energy.
- Row k is the **mean over step k**, so that the means over the steps of an hour are the hour's mean.
- Clock and calendar are local (IANA zone, with summer time); the day's radiation sum belongs to the local calendar day.

The sun's elevation is geometric, not apparent: refraction lifts the sun by half a degree at the horizon only, depends on the day's air,
and would add direct sun to minutes that have none. Twilight is treated on its own. Algorithm: NREL's SPA (Reda and Andreas, 2004) as in
pvlib, numpy version, with a fixed difference between terrestrial and universal time, so that nothing depends on tables that are updated.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from glbench.errors import WeatherError
from glbench.weather import preprocessing
from glbench.weather.record import RAW_SECONDS, SLOT_SECONDS, FloatArray, IntArray, Place, WeatherRecord, time_zone, utc_text

DELTA_T = 67.0  # s, terrestrial minus universal time; 65.5 to 69.4 s from 2008 to 2024, 1 s moves the sun by 0.004 deg
STANDARD_PRESSURE_HPA = 1013.25
MEAN_TEMPERATURE = 12.0  # degC; enters the refraction only, which is not used
REFRACTION_AT_SUNRISE = 0.5667  # deg; likewise
VERSION = 1
PARTS = SLOT_SECONDS // RAW_SECONDS
DAY_SECONDS = 86400
BLOCK_SECONDS = 4 * DAY_SECONDS  # Over which positions of the sun are computed at once and remembered
BRIGHTEST_BEAM = 1361.0  # W m-2, solar constant: kappa above it cannot be sunshine on a sun this low
TWILIGHT_SINE = float(np.sin(np.radians(6.0)))  # civil twilight lasts until the sun is 6 deg below the horizon


def sine_of_elevation(times: FloatArray, place: Place) -> FloatArray:
    """Sine of the sun's geometric elevation at ``times`` (seconds since 1970-01-01 UTC), the same shape."""
    from pvlib import spa

    flat = np.ascontiguousarray(times, dtype=np.float64).ravel()
    position = spa.solar_position_numpy(
        flat, place.latitude, place.longitude, place.altitude, STANDARD_PRESSURE_HPA, MEAN_TEMPERATURE, DELTA_T, REFRACTION_AT_SUNRISE, 1
    )
    return np.sin(np.radians(np.asarray(position[3], dtype=np.float64))).reshape(np.shape(times))


class Means:
    """Means over the intervals ``[starts, ends)`` ``(n,)`` [s], int64, of functions given cell by cell.

    Every interval is at least 1 s long and lies inside the cells, the first of which starts at ``begin``; ``cell`` is the length of each
    [s]. An interval inside one cell is never computed as a difference of long running sums, so nothing is lost to rounding.
    """

    def __init__(self, starts: IntArray, ends: IntArray, begin: int, cell: int) -> None:
        self._cell = cell
        self._first = (starts - begin) // cell
        self._last = (ends - begin - 1) // cell
        self._from = (starts - begin) - self._first * cell
        self._to = (ends - begin) - self._last * cell
        self._duration = ends - starts
        self._inside = self._first == self._last

    def of_constants(self, values: FloatArray) -> FloatArray:
        """Means (n,) of a function that is ``values[i]`` throughout cell i."""

        def partial(cells: IntArray, seconds: IntArray) -> FloatArray:
            return np.asarray(values[cells] * seconds)

        return np.where(self._inside, values[self._first], (self._across(values * self._cell, partial)) / self._duration)

    def of_lines(self, nodes: FloatArray) -> FloatArray:
        """Means (n,) of the function that runs linearly from ``nodes[i]`` to ``nodes[i + 1]`` in cell i."""
        rise = np.diff(nodes)

        def partial(cells: IntArray, seconds: IntArray) -> FloatArray:
            return np.asarray((nodes[cells] + rise[cells] * (seconds / (2.0 * self._cell))) * seconds)

        across = self._across((nodes[:-1] + rise / 2.0) * self._cell, partial)
        middle = (self._from + self._to) / (2.0 * self._cell)
        return np.where(self._inside, nodes[self._first] + rise[self._first] * middle, across / self._duration)

    def of_amounts(self, amounts: IntArray, shares: FloatArray) -> FloatArray:
        """Mean rates (n,) [amount per second] when cell i receives ``amounts[i]``, of which ``shares[i, j]`` by part j's start.

        ``shares`` (cells, parts + 1) rises from exactly 0 to exactly 1; within a part it is linear.
        """
        parts = shares.shape[1] - 1

        def share(cells: IntArray, seconds: IntArray) -> FloatArray:
            position = seconds * (parts / self._cell)
            part = np.minimum(position.astype(np.int64), parts - 1)
            low, high = shares[cells, part], shares[cells, part + 1]
            return np.asarray(low + (high - low) * (position - part))

        def partial(cells: IntArray, seconds: IntArray) -> FloatArray:
            return np.asarray(amounts[cells] * share(cells, seconds))

        inside = amounts[self._first] * (share(self._first, self._to) - share(self._first, self._from))
        return np.asarray(np.where(self._inside, inside, self._across(amounts, partial)) / self._duration)

    def _across(self, whole: FloatArray | IntArray, partial: Callable[[IntArray, IntArray], FloatArray]) -> FloatArray:
        """Integrals over intervals that span cells: the end of the first, the whole ones between, the beginning of the last."""
        running = np.concatenate(([0], np.cumsum(whole)))
        # Inside one cell there is nothing between; the caller takes its own value there.
        between = running[np.maximum(self._last, self._first)] - running[np.minimum(self._first + 1, self._last)]
        return np.asarray((whole[self._first] - partial(self._first, self._from)) + between + partial(self._last, self._to))


def prepare(record: WeatherRecord, window: preprocessing.Window) -> preprocessing.Prepared:
    """Disturbances of ``window``, each row the mean over its step.

    At the record's two ends, where an instant has no neighbour, its value is held (for less than an hour). Raises ``WeatherError`` when a
    local calendar day of the window has daylight hours that the record does not cover.
    """
    zone = time_zone(record.timezone)

    def midnight(number: int) -> int:
        return int(dt.datetime.combine(dt.date(1970, 1, 1) + dt.timedelta(days=number), dt.time(), tzinfo=zone).timestamp())

    # The local calendar days of the window: begin and end of each (seconds since 1970-01-01 UTC), and each step's day.
    local_day = (window.times + preprocessing.utc_offsets(window.times, record.timezone)) // DAY_SECONDS
    numbers, day_of_step = np.unique(local_day, return_inverse=True)
    begins = np.array([midnight(int(number)) for number in numbers], dtype=np.int64)
    ends = np.array([midnight(int(number) + 1) for number in numbers], dtype=np.int64)
    first = (max(min(window.start, int(begins[0])), record.begin) - record.begin) // SLOT_SECONDS
    last = -(-(min(max(window.end, int(ends[-1])), record.end) - record.begin) // SLOT_SECONDS)
    slots = _Slots(record, first, last)
    steps = Means(window.times, window.times + window.step, slots.begin, SLOT_SECONDS)
    samples = Means(window.times, window.times + window.step, slots.begin, RAW_SECONDS)
    temperature = slots.step_means("air_temperature", steps)
    is_day = slots.is_day
    is_day_smooth = np.where((is_day > 0.0) & (is_day < 1.0), preprocessing.sigmoid(is_day), is_day)
    values = np.column_stack(
        [
            steps.of_amounts(slots.energy, slots.shares),
            temperature,
            slots.step_means("vapour_pressure", steps),
            preprocessing.co2_density(temperature, window.co2_ppm),
            slots.step_means("wind_speed", steps),
            preprocessing.sky_temperature(record, lambda name: slots.step_means(name, steps), temperature, overcast=8.0),
            preprocessing.soil_temperature(preprocessing.seconds_into_year(np.asarray(window.times + window.step / 2.0, dtype=np.float64))),
            _radiation_sums(slots, begins, ends)[day_of_step],
            samples.of_constants(is_day),
            samples.of_constants(is_day_smooth),
        ]
    )
    # The slot before and the slot after were read too, for the instants and the clearness.
    return preprocessing.Prepared(values, max(first - 1, 0), min(last + 1, record.hours))


@dataclass(frozen=True)
class _Slots:
    """Slots ``first`` to ``last`` (exclusive) of a record, with the sun over them."""

    record: WeatherRecord
    first: int
    last: int

    @property
    def begin(self) -> int:
        """Start of the first slot, seconds since 1970-01-01 UTC."""
        return self.record.begin + SLOT_SECONDS * self.first

    @cached_property
    def sine(self) -> FloatArray:
        """Sine of the solar elevation in the middle of every 5 minutes, (slots + 2, 12): one slot more on either side."""
        return sines_over(self.record.place, self.begin - SLOT_SECONDS, self.last - self.first + 2)

    @property
    def energy(self) -> IntArray:
        """Radiation received in each slot [J m-2]."""
        return self.record.counts["global_radiation"][self.first : self.last]

    @cached_property
    def shares(self) -> FloatArray:
        """Share of each slot's energy received by the start of each of its 5-minute parts, and by its end: (slots, 13)."""
        sunshine = np.maximum(self.sine[1:-1], 0.0)
        twilight = np.maximum(self.sine[1:-1] + TWILIGHT_SINE, 0.0)
        hourly = self.record.values("global_radiation", self.first, self.last)
        # What no sun this low can give is twilight (or a bright cloud): it follows the twilight, or is spread evenly.
        from_sun = np.minimum(hourly, BRIGHTEST_BEAM * sunshine.mean(axis=1))
        parts = from_sun[:, None] * _normalised(self._clearness() * sunshine)
        parts += (hourly - from_sun)[:, None] * _normalised(twilight)
        running = np.cumsum(_normalised(parts), axis=1)
        # Divided by its own last value: exactly 1 from the last bright part on, so that a dark part receives exactly 0.
        return np.concatenate((np.zeros_like(running[:, :1]), running / running[:, -1:]), axis=1)

    def _clearness(self) -> FloatArray:
        """Kappa [W m-2] in the middle of every part, (slots, 12): linear between the middles of the sunlit slots.

        Where a neighbour is dark or outside the record, the slot's own kappa is held: evening and morning do not mix, and
        the result does not depend on the window asked for.
        """
        around = np.arange(self.first - 1, self.last + 1)
        inside = (around >= 0) & (around < self.record.hours)
        hourly = self.record.values("global_radiation")[np.where(inside, around, 0)]
        sunshine = np.maximum(self.sine, 0.0).mean(axis=1)
        sunlit = inside & (sunshine > 0.0)
        kappa = np.ones(around.size)
        kappa[sunlit] = np.minimum(hourly[sunlit] / sunshine[sunlit], BRIGHTEST_BEAM)
        own = kappa[1:-1, None]
        before = np.where(sunlit[:-2], kappa[:-2], kappa[1:-1])[:, None]
        after = np.where(sunlit[2:], kappa[2:], kappa[1:-1])[:, None]
        from_middle = (np.arange(PARTS) + 0.5) / PARTS - 0.5
        to_before, to_after = np.maximum(-from_middle, 0.0), np.maximum(from_middle, 0.0)
        return np.asarray(own + (before - own) * to_before + (after - own) * to_after)

    @cached_property
    def is_day(self) -> FloatArray:
        """Day flag on the 5-minute parts: sun above the horizon, with ramps of one hour centred on sunrise and sunset."""
        light = (self.sine > 0.0).astype(np.float64).ravel()
        hour_around = np.concatenate(([0.5], np.ones(PARTS - 1), [0.5]))
        margin = PARTS // 2
        return np.asarray(np.convolve(light, hour_around, mode="valid")[margin:-margin] / PARTS, dtype=np.float64)

    def step_means(self, name: str, steps: Means) -> FloatArray:
        """Means over the steps of the quantity ``name``, or of ``"vapour_pressure"`` [Pa], read as its timing says."""
        before = max(self.first - 1, 0)
        timing = self.record.timing["air_temperature" if name == "vapour_pressure" else name]
        if name == "vapour_pressure":
            values = preprocessing.vapour_pressure(
                self.record.values("air_temperature", before, self.last), self.record.values("relative_humidity", before, self.last)
            )
        else:
            values = self.record.values(name, before, self.last)
        if name == "cloud_cover":  # KNMI's 9 means that the sky cannot be seen: as good as overcast
            values = np.minimum(values, 8.0)
        if timing == "mean":
            return steps.of_constants(values[self.first - before :])
        return steps.of_lines(values if self.first > 0 else np.concatenate((values[:1], values)))


def sines_over(place: Place, begin: int, slots: int) -> FloatArray:
    """Sine of the solar elevation in the middle of every 5 minutes of ``slots`` hours from ``begin``, (slots, 12)."""
    phase = begin % RAW_SECONDS
    first, last = (moment // BLOCK_SECONDS for moment in (begin - phase, begin - phase + slots * SLOT_SECONDS - 1))
    sine = np.concatenate([_sine_in_block(place, block, phase) for block in range(first, last + 1)])
    skipped = (begin - phase - first * BLOCK_SECONDS) // RAW_SECONDS
    return sine[skipped : skipped + slots * PARTS].reshape(slots, PARTS)


@lru_cache(maxsize=512)
def _sine_in_block(place: Place, block: int, phase: int) -> FloatArray:
    """Sine of the solar elevation in the middle of all 5 minutes of a block, the first of which begins ``phase`` seconds after it, (1152,).

    Remembered, because it costs far more than all the rest, and windows overlap. Whole blocks, so that no bit depends on the window.
    """
    parts = np.arange(BLOCK_SECONDS // RAW_SECONDS)
    middles = np.asarray(block * BLOCK_SECONDS + phase + RAW_SECONDS * (parts + 0.5), dtype=np.float64)
    sine = sine_of_elevation(middles, place)
    sine.setflags(write=False)
    return sine


def _normalised(weights: FloatArray) -> FloatArray:
    """``weights`` (slots, parts) with mean 1 in every row; a row of zeros becomes ones (spread evenly)."""
    mean = weights.mean(axis=1, keepdims=True)
    return np.where(mean > 0.0, weights, 1.0) / np.where(mean > 0.0, mean, 1.0)


def _radiation_sums(slots: _Slots, begins: IntArray, ends: IntArray) -> FloatArray:
    """Radiation sum [MJ m-2] of each local calendar day (23 or 25 h long where the clock changes).

    Raises when the sun (or its twilight) shines in hours of a needed day that the record does not have.
    """
    record = slots.record
    for begin, end in ((int(begins[0]), record.begin), (record.end, int(ends[-1]))):
        if begin >= end:
            continue
        sine = sine_of_elevation(np.arange(begin, end, RAW_SECONDS, dtype=np.float64), record.place)
        if bool(np.any(sine > -TWILIGHT_SINE)):
            msg = (
                f"Weather '{record.name}' covers {record.period}: daylight hours from {utc_text(begin)} to {utc_text(end)} UTC are "
                f"missing, so the radiation sum of that day (clock of {record.timezone}) is unknown. Start a day later, or end a "
                "day earlier."
            )
            raise WeatherError(msg)
    begins, ends = np.maximum(begins, record.begin), np.minimum(ends, record.end)
    rates = Means(begins, ends, slots.begin, SLOT_SECONDS).of_amounts(slots.energy, slots.shares)
    return np.asarray(rates * (ends - begins) * 1e-6)
