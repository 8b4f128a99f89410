"""The weather of a run, computed again for `benchmarks/audit.py`: disturbances of steps, and seasons made of some years of a record.

Nothing here is glbench's: it is written from docs/weather.md and the decisions that it names. pvlib places the sun.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray
from pvlib import spa

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Hourly = tuple[int, Array, tuple[float, float, float], ZoneInfo]  # begin [s since 1970], whole numbers (hours, 5), place, clock

COUNTS = np.array([1000.0, 1000.0, 1000.0, 3600.0, 1000.0])  # of degC, % of humidity, m s-1 of wind, W m-2 of sun, octants of cloud
LIMITS = np.array([[-60.0, 0.0, 0.0, 0.0, 0.0], [60.0, 100.0, 75.0, 1500.0, 8.0]]) * COUNTS
CO2 = 101325.0 * 44.01e-3 / 8.3144598  # mg K m-3 of 1 ppm
WINDOW, NEAREST, NEIGHBOURS, REST, SHORTEST, LONGEST = 12, 5, 10, 10, 4, 10  # of the blocks that seasons are made of


class NotCoveredError(Exception):
    """Weather that is not computed here."""

    def __init__(self) -> None:
        super().__init__("the first and the last day of a record are not covered")


def saturation(t: Any, exp: Any = np.exp) -> Any:
    return 610.78 * exp(17.2694 * t / (t + 238.3))


def sky_temperature(t: Array, cloud: Array) -> Array:
    clear = (213.0 + 5.5 * t) / (5.67e-8 * (t + 273.15) ** 4)
    return np.asarray(((1.0 - 0.84 * cloud) * clear + 0.84 * cloud) ** 0.25 * (t + 273.15) - 273.15)


def soil_temperature(times: Any) -> Array:
    years = np.floor(times).astype("datetime64[s]").astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64)
    return np.asarray(10.0 + 5.0 * np.sin(2.0 * np.pi * ((times - years) / (365.0 * 86400.0) + 0.625)))


def conserving(hourly: Hourly, start: int, steps: int, step: int, ppm: Any) -> Array:
    """Disturbances `(steps, 10)` of that preprocessing: means over the steps, by way of cells of 5 minutes."""
    begin, counts, site, zone = hourly
    # Hours from two days before to two days after the steps, so that all their days are whole, and one more on either side.
    first, last = max((start - begin) // 3600 - 48, 1), min(-(-(start + steps * step - begin) // 3600) + 48, len(counts) - 1)
    t, humidity, wind, radiation, cloud = (counts / COUNTS)[first - 1 : last + 1].T
    begin, within = begin + first * 3600, (np.arange(12) + 0.5) / 12.0
    middles = begin - 3600 + 300.0 * (np.arange(len(t) * 12) + 0.5)
    sine = np.sin(np.radians(spa.solar_position_numpy(middles, *site, 1013.25, 12.0, 67.0, 0.5667, 1)[3])).reshape(-1, 12)

    def spread(weights: Array) -> Array:
        sums = weights.sum(axis=1, keepdims=True)
        return np.where(sums > 0.0, weights, 1.0) / np.where(sums > 0.0, sums, 12.0)

    def means(cells: Array) -> Array:
        return np.asarray(cells.ravel()[chosen].reshape(steps, -1).mean(axis=1))

    def lines(ends: Array) -> Array:
        return means(ends[:-2, None] + (ends[1:-1] - ends[:-2])[:, None] * within)

    sun = np.maximum(sine, 0.0)
    lit, most = sun.mean(axis=1) > 0.0, 1361.0 * sun.mean(axis=1)
    kappa = 1361.0 * np.minimum(radiation / np.where(lit, most, 1.0), 1.0)
    own, before, after = (np.where(lit[k : k - 2 or None], kappa[k : k - 2 or None], kappa[1:-1])[:, None] for k in (1, 0, 2))
    kappa = own + (before - own) * np.maximum(0.5 - within, 0.0) + (after - own) * np.maximum(within - 0.5, 0.0)
    beam = np.minimum(radiation, most)[1:-1, None] * spread(kappa * sun[1:-1])
    twilight = np.maximum(radiation - most, 0.0)[1:-1, None] * spread(np.maximum(sine[1:-1] + math.sin(math.radians(6.0)), 0.0))
    received = 3600.0 * (beam + twilight).ravel()  # J m-2 in a cell
    is_day = np.convolve(sine.ravel() > 0.0, np.r_[0.5, np.ones(11), 0.5] / 12.0, "same")[12:-12]
    moments, place = np.unique((begin + 300 * np.arange(len(received))) // 900, return_inverse=True)  # clocks change at quarters
    days = np.array([dt.datetime.fromtimestamp(900 * int(one), zone).toordinal() for one in moments])[place]
    chosen = slice((start - begin) // 300, (start + steps * step - begin) // 300)
    sums = (np.bincount(days - days[0], received) * 1e-6)[days[chosen][:: step // 300] - days[0]]
    mean_t, vapour, blown = lines(t), lines(humidity / 100.0 * saturation(t)), means(np.repeat(wind[1:-1], 12))
    sky, soil = sky_temperature(mean_t, lines(np.minimum(cloud, 8.0)) / 8.0), soil_temperature(start + step * (np.arange(steps) + 0.5))
    flags = [means(is_day), means(np.where((is_day > 0.0) & (is_day < 1.0), 1.0 / (1.0 + np.exp(5.0 - 10.0 * is_day)), is_day))]
    return np.column_stack([means(received) / 300.0, mean_t, vapour, ppm * CO2 / (mean_t + 273.15), blown, sky, soil, sums, *flags])


def paper(hourly: Hourly, start: int, steps: int, step: int, ppm: Any) -> Array:
    """The same of the preprocessing `paper`: values at the starts of the steps, on a grid of 5 minutes."""
    begin, counts, *_ = hourly
    first, last = (start - begin) // 3600 - 24, -(-(start + steps * step - begin) // 86400) * 24 + 25
    if first < 0 or last > len(counts):
        raise NotCoveredError
    fine, hours = np.arange((last - first - 1) * 12) / 12.0, (counts / COUNTS)[first:last]
    hours[:, 4] = sky_temperature(hours[:, 0], hours[:, 4] / 9.0)
    t, humidity, wind, radiation, sky = (np.interp(fine, np.arange(last - first), one) for one in hours.T)
    times, light, ramp = begin + 3600 * first + 300 * np.arange(len(fine)), radiation > 0.0, np.linspace(0.0, 1.0, 12)
    flags, days = [light.astype(float), light.astype(float)], times // 86400 - times[0] // 86400
    for edge in np.flatnonzero(light[1:] != light[:-1]):
        for flag, course in zip(flags, (ramp, 1.0 / (1.0 + np.exp(5.0 - 10.0 * ramp))), strict=True):
            flag[edge - 6 : edge + 6] = course if light[edge + 1] else 1.0 - course
    sums, soil = (np.bincount(days, radiation) * 300e-6)[days], soil_temperature(times)
    grid = np.column_stack([radiation, t, humidity / 100.0 * saturation(t), CO2 / (t + 273.15), wind, sky, soil, sums, *flags])
    grid = grid[(start - times[0]) // 300 :: step // 300][:steps]
    return np.asarray(grid * np.where(np.arange(10) == 3, np.reshape(ppm, (-1, 1)), 1.0))


def year_day(days: Ints) -> Ints:
    """Day of the year, 0 to 364, of days since 1970; 29 February counts as 28 February."""
    dates = [dt.date.fromordinal(dt.date(1970, 1, 1).toordinal() + int(day)) for day in days]
    return np.array([dt.date(2001, one.month, one.day - (one.month == 2 and one.day == 29)).timetuple().tm_yday - 1 for one in dates])


def waves(days: Any, count: int) -> Any:
    angle = 2.0 * np.pi / 365.0 * days
    return np.stack([np.ones_like(angle), *(f((k + 1) * angle) for k in range(count) for f in (np.cos, np.sin))], axis=-1)


class Generator:
    """Seasons made of some years of a record."""

    def __init__(self, hourly: Hourly, years: Sequence[int]) -> None:
        begin, counts, self.site, self.zone = hourly
        self.ahead = round(self.site[1] / 15.0) * 3600  # mean solar time, in whole hours
        self.days = np.concatenate([np.arange(f"{y}-01-01", f"{y + 1}-01-01", dtype="datetime64[D]") for y in sorted(years)]).astype(int)
        self.calendar, self.ends = year_day(self.days), np.append(np.flatnonzero(np.diff(self.days) != 1) + 1, len(self.days))
        self.counts = counts[((self.days * 86400 - self.ahead - begin) // 3600)[:, None] + np.arange(24)]
        self.counts[..., 4] = np.minimum(self.counts[..., 4], LIMITS[1, 4])
        self.grid = np.gcd.reduce(self.counts.reshape(-1, 5).astype(np.int64)).astype(float)
        # A clear sky (Haurwitz 1945) with the sun of Spencer (1971): means of hours [W m-2].
        spencer, latitude = waves(np.arange(365.0), 3), math.radians(self.site[0])
        declination = (spencer @ [0.006918, -0.399912, 0.070257, -0.006758, 0.000907, -0.002697, 0.00148])[:, None]
        equation = (spencer[:, :5] @ [0.0000075, 0.001868, -0.032077, -0.014615, -0.040849])[:, None] * 12.0 / np.pi
        turn = np.cos(np.pi / 12.0 * ((np.arange(288) + 0.5) / 12.0 + self.site[1] / 15.0 - self.ahead / 3600.0 + equation - 12.0))
        sine = math.sin(latitude) * np.sin(declination) + math.cos(latitude) * np.cos(declination) * turn
        light = np.where(sine > 0.0, 1098.0 * sine * np.exp(-0.057 / np.maximum(sine, 1e-3)), 0.0)
        self.clear = light.reshape(365, 24, 12).mean(axis=-1)
        fit = np.linalg.lstsq(waves(self.calendar + 0.5, 2), self.counts[..., 0].mean(axis=1))[0]
        self.warmth = (waves(np.arange(1, 365 * 24 + 1) / 24.0, 2) @ fit).reshape(365, 24)  # course of the temperature [counts]
        # What days are compared by: the last hour, the day, five days.
        state, swing = (self.counts / COUNTS)[..., [0, 1, 2, 4]], np.ptp(self.counts[..., 0], axis=1) / 1000.0
        state[..., 0] -= self.warmth[self.calendar] / 1000.0
        clearness = self.counts[..., 3].mean(axis=1) / 3600.0 / np.maximum(self.clear.mean(axis=1)[self.calendar], 1.0)
        day = np.column_stack([state[..., :3].mean(axis=1), clearness, swing])
        begins = np.append(0, self.ends)[np.searchsorted(self.ends, np.arange(len(day)), "right")]
        five = np.stack([day[max(begin, place - 4) : place + 1].mean(axis=0) for place, begin in enumerate(begins)])
        compared = np.concatenate([state[:, -1], day, five], axis=1)
        weights = np.sqrt([1, 1, 1, 1, 1, 1, 1, 1, 0.5, 1, 1, 1, 1, 0])
        self.features = np.round(compared / np.maximum(compared.std(axis=0), 1e-9) * weights, 9)
        near = [self.features[np.abs((self.calendar - one + 182) % 365 - 182) <= WINDOW] for one in self.calendar]
        unlike = [np.sort(((own - one) ** 2).sum(axis=1))[1 : NEIGHBOURS + 1] for own, one in zip(near, self.features, strict=True)]
        self.lonely = np.sqrt(np.mean(unlike, axis=1))

    def choices(self, recent: Ints, place: int, length: int) -> Ints:
        """Days that a block of that length may begin with at a place of the year, after the last days of the season so far."""
        begins: Ints = np.arange(len(self.days))
        possible = self.ends[np.searchsorted(self.ends, begins, "right")] - begins >= length
        if len(recent):
            possible &= ~np.isin(begins, [0, *self.ends, recent[-1] + 1])
            possible &= ~((recent >= begins[:, None] - 1) & (recent < begins[:, None] + length)).any(axis=1)
        distance = np.abs((self.calendar - place + 182) % 365 - 182)
        window = next(one for one in range(WINDOW, 365, 5) if (possible & (distance <= one)).sum() >= NEAREST)
        begins = begins[possible & (distance <= window)]
        if not len(recent):
            return begins
        unlike = ((self.features[begins - 1] - self.features[recent[-1]]) ** 2).sum(axis=1) / self.lonely[begins - 1]
        return begins[np.argsort(unlike, kind="stable")[:NEAREST]]

    def season(self, start: int, numbers: Array) -> Hourly:
        """The season from two days before the day `start` on, of as many days as there are pairs of `numbers`."""
        places, chain, joints = year_day(start - 2 + np.arange(len(numbers))), np.empty(0, np.int64), list[int]()
        shares = np.cumsum(np.minimum(np.arange(LONGEST, 0, -1), LONGEST - SHORTEST + 1))
        for u, v in numbers:
            # The season begins somewhere in a block, of which it has the rest.
            length = SHORTEST + int(u * (LONGEST - SHORTEST + 1)) if joints else 1 + int(np.searchsorted(shares, u * shares[-1], "right"))
            choices = self.choices(chain[-REST:], int(places[len(chain)]), length)
            chain = np.append(chain, choices[int(v * len(choices))] + np.arange(length))
            if len(chain) >= len(places):
                break
            joints.append(len(chain))
        chain = chain[: len(places)]
        season, source = self.counts[chain], self.calendar[chain]
        season[..., 0] += self.warmth[places] - self.warmth[source]
        here, there, measured = self.clear[places], self.clear[source], self.counts[chain, :, 3]
        for day, hour in np.ndindex(here.shape):
            high, now = np.flatnonzero(there[day] > 15.0), here[day, hour]
            if len(high) and (hour in high or now > 15.0):  # by the clearness of the hour, or of the nearest one with a high sun
                near = high[np.abs(high - hour).argmin()]
                season[day, hour, 3] = measured[day, near] * now / there[day, near]
            elif now > 15.0 or now == 0.0 < there[day, hour]:
                season[day, hour, 3] = 0.0
        ramp = (np.arange(1, 25) / 48.0)[:, None]
        for joint in joints:
            before, own = chain[joint - 1], chain[joint] - 1
            gap = self.counts[before, -1] - self.counts[own, -1]
            gap[0] += self.warmth[self.calendar[own], -1] - self.warmth[self.calendar[before], -1]
            gap[3] = 0.0
            season[joint - 1] -= ramp * gap
            season[joint] += ramp[::-1] * gap
        counts = np.clip(np.rint(season / self.grid) * self.grid, *LIMITS).reshape(-1, 5)
        return (start - 2) * 86400 - self.ahead, counts, self.site, self.zone
