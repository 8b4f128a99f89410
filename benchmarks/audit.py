"""Recompute a result of glbench from its record of actions, without trusting the package that made it.

    python benchmarks/audit.py RESULT.json [--runs N] [--task FILE.toml]

The exit code is 0 if the result agrees, 1 if it differs (in which run, step and number), 2 if it cannot be audited (why).

**From glbench** comes `glbench.model` alone: right-hand side of the plain model, names, sizes of states, parameters and how they follow.

**Written again here**, from the documentation: digests of results and records, inheritance of task files, Philox and all draws, weather and
seasons, the start, actuation, the meters of violations, the integration, ledger, reward, sums and means.

**Other libraries**: mcap unpacks the record, pyarrow reads the weather, pvlib places the sun. docs/verification.md has the tolerances.
"""

from __future__ import annotations

import argparse
import datetime as dt
import hashlib
import json
import math
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from decimal import Decimal
from functools import partial, reduce
from pathlib import Path
from typing import Any, NoReturn
from zoneinfo import ZoneInfo

import casadi
import numpy as np
import pyarrow.parquet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray
from pvlib import spa
from scipy.integrate import ode

from glbench.model import get_model

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Table = dict[str, Any]
Run = tuple[Table, Array, Array, Array]  # how it ended, actions, rewards, final state
Hourly = tuple[int, Array, tuple[float, float, float], ZoneInfo]  # begin [s since 1970], whole numbers (hours, 5), place, clock

ROOT, DIFFERS, CANNOT = Path(__file__).resolve().parents[1], 1, 2
AIR = ("air_temperature", "co2", "relative_humidity")  # degC, ppm, %

TOLERANCE = 1e-9  # of the integration: relative, and as a share of the typical size of a state
STATES = 1e-6  # final states may be off by this share of their typical size: what the kernel promises for a step
AT_END, MEAN = (1e-4, 1e-3, 1e-4), (2e-3, 2e-2, 2e-3)  # violations, by the same promise; means depend on when air crosses a limit
MONEY, SUMS = 1e-8, 1e-7  # profit of a step [EUR m-2]; sums over a run, relative to 1 or more
IN_ALL, HOURS = 10.0, 0.01  # rewards and penalties of a run, in those of a step; share of hours outside limits, besides 1 h

COUNTS = np.array([1000.0, 1000.0, 1000.0, 3600.0, 1000.0])  # of degC, % of humidity, m s-1 of wind, W m-2 of sun, octants of cloud
LIMITS = np.array([[-60.0, 0.0, 0.0, 0.0, 0.0], [60.0, 100.0, 75.0, 1500.0, 8.0]]) * COUNTS
CO2 = 101325.0 * 44.01e-3 / 8.3144598  # mg K m-3 of 1 ppm
WINDOW, NEAREST, NEIGHBOURS, REST, SHORTEST, LONGEST = 12, 5, 10, 10, 4, 10  # of the blocks that seasons are made of


class VerdictError(Exception):
    """Why an audit ends before all was found to agree: exit code and words."""


def end(code: int, words: str) -> NoReturn:
    raise VerdictError(code, words)


def canonical(value: Any) -> str:
    """JSON by RFC 8785: sorted keys, no spaces, numbers as ECMAScript writes them."""
    if isinstance(value, dict):
        keys = sorted(value, key=lambda key: str(key).encode("utf-16-be"))
        return "{" + ",".join(f"{canonical(key)}:{canonical(value[key])}" for key in keys) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(canonical, value)) + "]"
    if type(value) not in (int, float):
        return json.dumps(value, ensure_ascii=False)
    text = repr(float(value))
    if value == 0.0 or 1e-6 <= abs(value) < 1e21:
        return format(Decimal(text) + 0, "f").removesuffix(".0")
    return re.sub(r"e([+-])0*", r"e\1", text)


def read_record(path: Path) -> tuple[Table, list[Run], str]:
    """Provenance and runs of a record of actions, and the digest of its content (docs/episodes.md)."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        texts = {one.name: one.data for one in reader.iter_attachments()}
        parts = [(channel.topic, part) for _, channel, _, part in reader.iter_decoded_messages(log_time_order=False)]
    provenance, sha, runs = json.loads(texts["provenance.json"]), hashlib.sha256(), []
    kind = np.dtype("<f8" if (field := parts[0][1].DESCRIPTOR.fields_by_name["actions"]).type == field.TYPE_DOUBLE else "<f4")
    for text in (texts["provenance.json"], texts["runs.json"], texts["task.json"]):
        sha.update(len(text).to_bytes(8, "little") + text)
    sha.update(kind.name.encode())
    for run in json.loads(texts["runs.json"])["runs"]:
        own = sorted((part for topic, part in parts if topic == f"/runs/{run['seed']}"), key=lambda part: int(part.first_step))
        actions = np.concatenate([np.array(part.actions, kind).reshape(len(provenance["agent"]["columns"]), -1).T for part in own])
        rewards, final = np.concatenate([np.array(part.rewards, "<f8") for part in own]), np.array(own[-1].final_state, "<f8")
        for array in (actions, rewards, final):
            sha.update(np.ascontiguousarray(array).tobytes())
        runs.append((run, actions.astype(np.float64), rewards, final))
    return provenance, runs, sha.hexdigest()


def task_tables(name: str, folder: Path) -> Table:
    """The tables of a task file, or of a shipped task, with those of its bases (docs/tasks.md, docs/task-file.md)."""
    path = folder / name if name.endswith(".toml") else ROOT / "tasks" / f"{name.rpartition('/')[2].lower()}.toml"
    if not path.is_file():
        end(CANNOT, f"there is no task file {path}: name it with --task")
    own = tomllib.loads(path.read_text(encoding="utf-8"))
    if "base" not in own:
        return own
    below = task_tables(own.pop("base"), path.parent)
    if below["schema"] != own.get("schema", below["schema"]):
        end(CANNOT, "a base of another schema is not covered")
    for key in own.pop("without", []):
        *tables, last = key.split(".")
        del reduce(dict.__getitem__, tables, below)[last]
    if any("years" in split for split in own.get("splits", {}).values()):
        below.pop("splits", None)
    return merged(below, own)


def merged(below: Table, own: Table) -> Table:
    both = {key: (below[key], value) for key, value in own.items() if isinstance(value, dict) and isinstance(below.get(key), dict)}
    return below | own | {key: merged(*pair) for key, pair in both.items()}


def number(quantity: Any) -> float:
    return float(quantity["value"] if isinstance(quantity, dict) else quantity)


def uniforms(label: str, step: int, count: int) -> Array:
    """Numbers in [0, 1) of the stream that is called `label`, in a step: Philox4x32-10 (docs/adr/0006, 0014)."""
    key, numbers = hashlib.sha256(label.encode()).digest(), list[float]()
    low, high = int.from_bytes(key[:4], "big"), int.from_bytes(key[4:8], "big")
    for block in range((count + 1) // 2):
        a, b, c, d, k, m = step, block, 0, 0, low, high
        for _ in range(10):
            left, right = 0xD2511F53 * a, 0xCD9E8D57 * c
            a, b, c, d = (right >> 32) ^ b ^ k, right & 0xFFFFFFFF, (left >> 32) ^ d ^ m, left & 0xFFFFFFFF
            k, m = (k + 0x9E3779B9) & 0xFFFFFFFF, (m + 0xBB67AE85) & 0xFFFFFFFF
        numbers += [((one >> 5) * 2**26 + (other >> 6)) * 2.0**-53 for one, other in ((a, b), (c, d))]
    return np.array(numbers[:count])


def read_weather(source: str) -> Hourly:
    """KNMI's own numbers, as weather/manifest.toml explains them."""
    entry = tomllib.loads((ROOT / "weather" / "manifest.toml").read_text(encoding="utf-8"))["record"].get(source, {})
    if entry.get("format") != "knmi":
        end(CANNOT, f"[weather] source = '{source}': only KNMI's records are covered")
    table = pyarrow.parquet.read_table(ROOT / "weather" / entry["file"])
    factors = {"T": 100.0, "U": 1000.0, "FH": 100.0, "Q": 1e4, "N": 1000.0}
    counts = np.stack([table[name].to_numpy() * factor for name, factor in factors.items()], axis=1)
    return int(entry["first"].timestamp()), counts, (entry["latitude"], entry["longitude"], entry["altitude"]), ZoneInfo(entry["timezone"])


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
        end(CANNOT, "the first and the last day of a record are not covered")
    fine, hours = np.arange((last - first - 1) * 12) / 12.0, (counts / COUNTS)[first:last]
    hours[:, 4] = sky_temperature(hours[:, 0], hours[:, 4] / 9.0)
    t, humidity, wind, radiation, sky = (np.interp(fine, np.arange(last - first), one) for one in hours.T)
    times, light, ramp = begin + 3600 * first + 300 * np.arange(len(fine)), radiation > 0.0, np.linspace(0.0, 1.0, 12)
    flags, days = [light.astype(float), light.astype(float)], times // 86400 - times[0] // 86400
    for edge in np.flatnonzero(light[1:] != light[:-1]):
        for flag, course in zip(flags, (ramp, 1.0 / (1.0 + np.exp(5.0 - 10.0 * ramp))), strict=True):
            flag[edge - 6 : edge + 6] = course if light[edge + 1] else 1.0 - course
    sums, soil = (np.bincount(days, radiation) * 300e-6)[days], soil_temperature(times)
    grid = np.column_stack([radiation, t, humidity / 100.0 * saturation(t), ppm * CO2 / (t + 273.15), wind, sky, soil, sums, *flags])
    return np.asarray(grid[(start - times[0]) // 300 :: step // 300][:steps])


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


COVERED = re.compile(
    r"(schema|id|title|description|suites|observation|sensors|samples|outdoor_sensors|evaluation|prices|constraints|splits)\b.*"
    r"|weather\.((source|preprocessing|start|days|co2_ppm)=.*|step_seconds=(300|600|900|1200|1800|3600))|initial_state\.(kind=mature_crop|air_temperature.*)"
    r"|model\.(id=greenlight-tomato(-harvest|-season)?-1\.0\.0|(variant|parameters)=.*)"
    r"|uncertainty\.(distribution=uniform|redraw=(step|episode)|(delta|half_width_factor|parameters)\b.*)"
    r"|scenario\.((family|salt|start_within_days)=.*|generated=True|co2_range\..*)"
    r"|scenario\.(parameters|start)\.\d+\.(distribution=uniform|redraw=(step|episode)|half_width=.*|(name|parameters|states)\b.*)"
    r"|actuation\.(kind=rate|max_change=.*|controls\..*)|reward\.(modules\.\d=(epi|scaled_epi|scaled_penalty)|(penalty_scale|violation_price)\..*)"
    r"|ledger\.\w+\.((side|amount|unit|factor|label)=.*|stock=fruit|flow=(heat|electricity|co2_dosed|fruit_growth|fruit_harvested)|price\..*)",
    re.DOTALL,
)
"""What a task may say, key by key. What only concerns observations changes no reward of recorded actions."""


def said(value: Any, key: str = "") -> list[str]:
    """A task as lines such as `weather.days=60`."""
    if not isinstance(value, dict | list):
        return [f"{key}={value}"]
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    return [line for name, inner in pairs for line in said(inner, f"{key}.{name}" if key else str(name))]


def air_of(parcel: Any, exp: Any = np.exp) -> list[Any]:
    """Temperature [degC], CO2 [ppm] and relative humidity [%] from temperature, CO2 density [mg m-3] and vapour pressure [Pa]."""
    t, co2, vapour = parcel
    return [t, co2 * (t + 273.15) / CO2, 100.0 * vapour / saturation(t, exp)]


class Task:
    """A task in one of its splits, with own meters on the air outside its limits if violations are means, and an integrator."""

    def __init__(self, tables: Table, split: str | None) -> None:
        strange, reward, table = [line for line in said(tables) if not COVERED.fullmatch(line)], tables["reward"], tables["model"]
        self.split, self.hourly, self.paper = split, read_weather(tables["weather"]["source"]), tables["schema"] == 1
        strange += ["draws of real years"] if bool(split) != tables.get("scenario", {}).get("generated", False) else []
        strange += ["'scaled_epi' of schema 2"] if "scaled_epi" in reward["modules"] and not self.paper else []
        if strange or len({"penalty_scale", "violation_price"} & reward.keys()) > 1:
            end(CANNOT, f"not covered in the task: {', '.join(strange) or 'violations with a scale and a price'}")
        if self.paper:  # its prices are a ledger, its uncertainty is a scenario
            noise, price = tables["uncertainty"], {name: number(value) for name, value in tables["prices"].items()}
            fresh, goods = 1e-6 / price["dry_matter_content"], {"heat": "heat", "electricity": "electricity", "co2": "co2_dosed"}
            ledger = {f"cost_{one}": {"side": "paid", "flow": flow, "amount": one, "price": price[one]} for one, flow in goods.items()}
            ledger["revenue"] = {"side": "earned", "flow": "fruit_growth", "amount": "yield", "factor": fresh, "price": price["fruit"]}
            groups = [noise | {"half_width": noise["delta"] * noise["half_width_factor"]}]
            tables = tables | {"ledger": ledger, "scenario": {"parameters": groups}}
        self.tables, self.scenario, self.step = tables, tables["scenario"], int(tables["weather"]["step_seconds"])
        self.hours, self.limited, wide = self.step / 3600.0, tables.get("constraints", {}), {"low": -1e9, "high": 1e9}
        self.steps, self.means = tables["weather"]["days"] * 86400 // self.step, self.limited.get("judged", "end") == "mean"
        self.limits = [[number(self.limited.get(name, wide)[one]) for one in ("low", "high")] for name in AIR]
        self.model = get_model(table.get("id", "greenlight-tomato-1.0.0"), table.get("variant", "author"))
        self.states, self.controls, self.parameters = (list(self.model.names[one]) for one in "xup")
        self.air = [self.states.index(name) for name in ("tAir", "co2Air", "vpAir")]
        self.scale = np.array([state.scale for state in self.model.states])
        self.nominal = np.array(self.model.parameters.default(table.get("parameters", "benchmark")))
        p: dict[str, float] = dict(zip(self.parameters, self.nominal.tolist(), strict=True))
        # What flows is a multiple of a control, or of the change of a state.
        heat, dose = (p[one] / p["aFlr"] for one in ("pBoil", "phiExtCo2"))
        flows = {"heat": ("uBoil", heat * self.hours / 1e3), "electricity": ("uLamp", p["thetaLampMax"] * self.hours / 1e3)}
        flows |= {"co2_dosed": ("uCo2", dose * self.step * 1e-6), "fruit_harvested": ("sumMcFruitHar", 1.0)}
        flows, self.items = flows | dict.fromkeys(("fruit", "fruit_growth"), ("cFruit", 1.0)), []
        for name, item in tables["ledger"].items():
            flow = item.get("flow") or item["stock"]
            amount, (source, factor) = item.get("amount") or (flow if "flow" in item else f"{flow}_gained"), flows[flow]
            self.items.append((name, amount, source, item.get("factor", 1.0) * factor, item["side"] == "earned", number(item["price"])))
        paid, grown = (float(sum(worth * price for *_, worth, earned, price in self.items if earned == side)) for side in (False, True))
        self.low, self.high = (-paid, p["rgFruit"] * self.step * grown) if self.paper else (0.0, 1.0)  # profit of 0 and 1 when scaled
        costs, scales = reward.get("violation_price", {}), reward.get("penalty_scale", {})
        self.weights = [number(costs.get(name, 0.0)) * self.hours if costs else 1.0 / number(scales.get(name, math.inf)) for name in AIR]
        self.penalty_margin = sum(2.0 * weight * near for weight, near in zip(self.weights, MEAN if self.means else AT_END, strict=True))
        self.margin = self.penalty_margin + MONEY / (self.high - self.low)
        self.generator = Generator(self.hourly, tables["splits"][split]["years"]) if split else None
        self.solver = self._integrator()

    def _integrator(self) -> Any:
        x, u, d, p = (casadi.SX.sym(name, size) for name, size in self.model.sizes.items())
        ends = zip(air_of([x[place] for place in self.air], casadi.exp), self.limits if self.means else (), strict=False)
        outside = [casadi.fmax(0.0, one) for value, (low, high) in ends for one in (low - value, value - high)]
        rates, x = casadi.vertcat(self.model.rhs_function()(x, u, d, p), *outside), casadi.vertcat(x, casadi.SX.sym("meters", len(outside)))
        self.inputs, calls = [np.zeros(one.numel()) for one in (x, u, d, p)], []
        for expression in (rates, casadi.jacobian(rates, x).T):  # transposed, because CasADi stores columns
            function = casadi.Function("f", [x, u, d, p], [casadi.cse(casadi.densify(expression))])
            result, (buffer, call) = np.zeros(expression.shape).squeeze(), function.buffer()
            for place, array in enumerate(self.inputs):
                buffer.set_arg(place, array.data)  # type: ignore[call-arg]
            buffer.set_res(0, result.data)  # type: ignore[call-arg]
            calls.append((call, result, buffer, function))

        def evaluate(which: int, _: float, state: Array) -> Array:
            self.inputs[0][:] = state
            calls[which][0]()
            return np.array(calls[which][1])

        errors = np.append(TOLERANCE * self.scale, [1e-6 * self.step] * len(outside))
        solver: Any = ode(partial(evaluate, 0), partial(evaluate, 1))
        return solver.set_integrator("lsoda", rtol=TOLERANCE, atol=errors, nsteps=100000)

    def advance(self, x: Array, *held: Array) -> Array:
        """The state a control step later, with controls, weather and parameters held."""
        for array, values in zip(self.inputs[1:], held, strict=True):
            array[:] = values
        after = np.asarray(self.solver.set_initial_value(x, 0.0).integrate(float(self.step)))
        if not self.solver.successful() or not np.isfinite(after).all():
            end(CANNOT, "a step cannot be integrated")
        return after

    def uniforms(self, of: object, name: str, step: int, count: int) -> Array:
        """Random numbers of a run or season."""
        salt = "\n".join(filter(None, (self.scenario.get("salt"), self.split)))
        family = f" uncertain parameters\n{self.tables['id']}\n{of}" if self.paper else f"\n{self.scenario['family']}\n{salt}\n{of}\n{name}"
        return uniforms(f"glbench{family}", step, count)

    def draw(self, parameters: Array, seed: int, step: int | None) -> Array:
        """Parameters with the draws of a step, or those of the episode (None)."""
        drawn, place = parameters.copy(), self.parameters.index
        for k, group in enumerate(self.scenario.get("parameters", [])):
            if (group["redraw"] == "step") != (step is not None) or group["half_width"] == 0.0:
                continue
            names = self.model.parameters.drawn_set(group["parameters"]) if isinstance(group["parameters"], str) else group["parameters"]
            followers = {one.name for one in self.model.table if set(names) & set(re.findall(r"\w+", one.formula))}
            if followers - {"cLeafMax"}:
                end(CANNOT, f"not covered: {', '.join(followers)} follow from drawn parameters")
            places = [place(name) for name in names]
            numbers = self.uniforms(seed, f"parameters {group.get('name') or f'parameters {k}'}", step or 0, len(places))
            drawn[places] = self.nominal[places] * (1.0 + group["half_width"] * (2.0 * numbers - 1.0))
            drawn[place("cLeafMax")] = drawn[place("laiMax")] / drawn[place("sla")]
        return drawn

    def weather(self, seed: int) -> Array:
        """Disturbances of the run with that seed `(steps, 10)`."""
        table, hourly, late = self.tables["weather"], self.hourly, 0
        ppm: Any = number(table["co2_ppm"])
        if self.generator is not None:
            season = (seed - self.tables["evaluation"]["first_seed"]) % self.tables["splits"][self.split]["seasons"]
            shift = self.uniforms("all seasons", "start days", 0, 1)[0] + 0.6180339887498949 * season
            late = math.floor((self.scenario.get("start_within_days", 0) + 1) * (shift % 1.0))
            first = table["start"].toordinal() - dt.date(1970, 1, 1).toordinal() + late
            count = table["days"] + 7
            hourly = self.generator.season(first, self.uniforms(f"season {season}", "weather", 0, 2 * count).reshape(-1, 2))
            if "co2_range" in self.scenario:
                low, high = (number(self.scenario["co2_range"][one]) for one in ("low", "high"))
                path, every = list[float](), max(3600 // self.step, 1)
                for hour in range(-(-self.steps // every)):
                    shock = 2.0 * (self.uniforms(f"season {season}", "CO2 outside", hour, 3).sum() - 1.5)
                    path.append(0.979 * path[-1] + math.sqrt(1.0 - 0.979**2) * shock if path else shock)
                wave = np.repeat(np.clip(np.array(path) / 2.0, -1.0, 1.0), every)[: self.steps]
                ppm = (low + high) / 2.0 + (high - low) / 2.0 * wave
        prepare, zone = (conserving, hourly[3]) if table["preprocessing"] == "conserving" else (paper, dt.UTC)
        start = int(dt.datetime.combine(table["start"], dt.time(), zone).timestamp()) + 86400 * late
        return prepare(hourly, start, self.steps, self.step, ppm)

    def start(self, seed: int, weather: Array) -> Array:
        """State at the start (docs/nomenclature.md): all surfaces and screens at one temperature, meters and clock at 0."""
        t, co2, soil = number(self.tables["initial_state"]["air_temperature"]), float(weather[3]), float(weather[6])
        values = {name: t for name in self.states if re.fullmatch(r"t(Air|Top|Cov\w*|\w*Scr|Flr|\w*Pipe|\w*Lamp)", name)}
        values |= {f"tSo{layer + 1}": ((4 - layer) * t + layer * soil) / 4.0 for layer in range(5)}
        values |= {"tCan": t + 4.0, "tCan24": t + 4.0, "co2Air": co2, "co2Top": co2}
        sla, place = self.model.parameters.default("benchmark"), self.parameters.index("sla")
        values |= {"cLeaf": 95283.0 * sla[place] / self.nominal[place], "cStem": 251070.0, "cFruit": 55338.0, "tCanSum": 3097.8}
        values |= dict.fromkeys(("vpAir", "vpTop"), 0.9 * float(saturation(t)))
        x = np.array([values.get(name, 0.0) for name in self.states] + [0.0] * (6 * self.means))
        for k, group in enumerate(self.scenario.get("start", [])):
            numbers = self.uniforms(seed, f"start {group.get('name') or f'start {k}'}", 0, len(group["states"]))
            x[[self.states.index(name) for name in group["states"]]] *= 1.0 + group["half_width"] * (2.0 * numbers - 1.0)
        return x

    def quantities(self, before: Array, after: Array, u_before: Array, u: Array) -> dict[str, float]:
        """What a step adds to the metrics."""
        changes = dict(zip([*self.states, *self.controls], [*(after - before)[: len(self.states)].tolist(), *u.tolist()], strict=True))
        rows = {"reward": 0.0, "epi": 0.0, "penalty": 0.0} | ({} if self.paper else {"actuator_travel": float(np.abs(u - u_before).sum())})
        for name, amount, source, factor, earned, price in self.items:
            rows[amount] = changes[source] * factor
            rows[name] = rows[amount] * price
            rows["epi"] += rows[name] if earned else -rows[name]
        air, meters = air_of(after[self.air]), (after - before)[len(self.states) :] / self.step
        air[2], hours = min(max(air[2], 0.0), 100.0), dict[str, float]()
        for place, (name, (low, high)) in enumerate(zip(AIR, self.limits, strict=True)):
            sides = meters[2 * place : 2 * place + 2].tolist() if self.means else [low - float(air[place]), float(air[place]) - high]
            rows["penalty"] += sum(max(one, 0.0) for one in sides) * self.weights[place]
            if name in self.limited:
                hours |= {f"hours_{name}_{side}": self.hours * (one > 0.0) for side, one in zip(("low", "high"), sides, strict=True)}
        hours |= {"hours_outside_limits": max(hours.values())} if hours else {}
        parts = {"epi": rows["epi"], "scaled_epi": (rows["epi"] - self.low) / (self.high - self.low), "scaled_penalty": -rows["penalty"]}
        return rows | hours | {"reward": sum(parts[one] for one in self.tables["reward"]["modules"])}


def compare(what: str, own: float, theirs: float, margin: float) -> float:
    """How far two numbers are apart, within the margin."""
    if not abs(own - theirs) <= margin:
        end(DIFFERS, f"{what} is {own!r}, and {theirs!r} in the result or its record (tolerance {margin:.1e})")
    return abs(own - theirs)


def audit_run(task: Task, run: Run, metrics: Mapping[str, float], *, direct: bool) -> str:
    """Recompute a run, and say how closely it agrees."""
    (_, actions, rewards, final), seed, sums, actuation = run, run[0]["seed"], dict[str, float](), task.tables["actuation"]
    weather, parameters, worst, u = task.weather(seed), task.draw(task.nominal, seed, None), 0.0, np.zeros(len(task.controls))
    x, places = task.start(seed, weather[0]), [task.controls.index(name) for name in actuation["controls"]]
    if not ((actions >= (-1e-6 if direct else -1.0 - 1e-6)) & (actions <= 1.0 + 1e-6)).all():
        end(DIFFERS, f"run {seed}: an action is outside its bounds")
    for k, recorded in enumerate(rewards.tolist()):
        before, u_before, u = x, u, np.clip(actions[k], 0.0, 1.0) if direct else np.zeros_like(u)
        if not direct:
            u[places] = np.clip(u_before[places] + actuation["max_change"] * np.clip(actions[k], -1.0, 1.0), 0.0, 1.0)
        x = task.advance(before, u, weather[k], task.draw(parameters, seed, k))
        rows = task.quantities(before, x, u_before, u)
        sums = {name: sums.get(name, 0.0) + value for name, value in rows.items()}
        worst = max(worst, compare(f"run {seed}, step {k + 1}: the reward", rows["reward"], recorded, task.margin))
    ends = zip(task.states, x.tolist(), map(float, final.reshape(len(x))), task.scale.tolist(), strict=False)
    off = max(compare(f"run {seed}: '{name}' at the end", own, theirs, STATES * scale) / scale for name, own, theirs, scale in ends)
    missing, charge = task.steps - len(rewards), task.tables["evaluation"]["failed_step"]
    total = float(np.add.accumulate(np.append(0.0, rewards))[-1]) + missing * number(charge["reward"])
    compare(f"run {seed}: the sum of the recorded rewards", total, metrics["reward"], 0.0)
    for name in sorted(sums.keys() | metrics.keys()):
        own = sums.get(name, 0.0) + missing * number(charge.get(name, 0.0))
        margin = IN_ALL * {"reward": task.margin, "penalty": task.penalty_margin}.get(name, SUMS / IN_ALL * max(abs(own), 1.0))
        margin += HOURS * own + 1.0 if name.startswith("hours_") else 0.0
        compare(f"run {seed}: '{name}'", own, metrics.get(name, math.nan), margin)
    score = f"{abs(sums.get('reward', 0.0) - rewards.sum()):.1e} of {total:.6g} (tolerance {IN_ALL * task.margin:.1e})"
    step = f"{len(rewards)} steps; reward of a step within {worst:.1e} (tolerance {task.margin:.1e})"
    return f"run {seed}: {step}, of the run within {score}, final state within {off:.1e} of its typical size (tolerance {STATES:.0e})"


def audit(path: Path, most: int | None, task_file: str | None) -> list[str]:
    """Audit a result, or the first ``most`` runs of it; sentences about what agrees."""
    result = json.loads(path.read_text(encoding="utf-8"))
    runs, seeds, (name, digest) = result["runs"], result["evaluation"]["seeds"], (result["task"][one] for one in ("id", "digest"))
    if result["task"].get("salt_commitment") or not result["record"]:
        end(CANNOT, "results of sealed rounds, and those without a record, are not covered")
    covered = {"task": digest, "agent": {one: result["agent"][one] for one in ("name", "digest")}, "runs": runs}
    means = {name: math.fsum(run["metrics"][name] for run in runs) / len(runs) for name in runs[0]["metrics"]}
    n, good, numbers = len(runs), sum(run["status"] == "ok" for run in runs), list(range(seeds[0], seeds[0] + len(runs)))
    summary = {"runs": n, "ok": good, "failed": n - good, "statuses": Counter(run["status"] for run in runs), "mean": means}
    if hashlib.sha256(canonical(covered).encode()).hexdigest() != result["results_digest"] or summary != result["summary"]:
        end(DIFFERS, "results_digest or the summary do not follow from the runs")
    if not numbers == seeds == [run["seed"] for run in runs] or (result["evaluation"]["runs"], {*result["units"]}) != (n, {*means}):
        end(DIFFERS, "units or number of runs, or seeds, are not those of the runs, one after the other")
    provenance, recorded, content = read_record(path.with_name(result["record"]["file"]))
    facts = [[[run[one] for one in ("seed", "status", "reason", "steps")] for run in some] for some in (runs, [run[0] for run in recorded])]
    facts += [[one["task"]["digest"], *(one["agent"][key] for key in ("name", "digest", "privileged"))] for one in (result, provenance)]
    if content != result["record"]["digest"] or facts[0] != facts[1] or facts[2] != facts[3]:
        end(DIFFERS, "the record is not the one that the result names, or tells something else of its runs, task or agent")
    tables, lock = task_tables(task_file or name, Path()), tomllib.loads((ROOT / "tasks" / "lock.toml").read_text(encoding="utf-8"))
    if tables["id"] != name or lock.get(name, {"digest": digest})["digest"] != digest:
        end(DIFFERS if tables["id"] == name else CANNOT, f"the digest is not that of {name}, or the task file is of {tables['id']}")
    task, words = Task(tables, result["task"].get("split")), list[str]()
    compare("the number of steps", task.steps, result["task"]["steps"], 0.0)
    for run, given in list(zip(recorded, runs, strict=True))[:most]:
        if given["status"] == "simulation_failed" or (given["status"] == "ok") != (given["steps"] == task.steps):
            end(CANNOT, f"run {given['seed']} is {given['status']} after {given['steps']} steps, which is not covered")
        words.append(audit_run(task, run, given["metrics"], direct=provenance["agent"]["acts"] == "controls"))
    return [*words, f"agrees ({len(words)} of {len(runs)} runs)"] if words else end(CANNOT, "no run to audit: --runs must be at least 1")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Recompute a result of glbench from its record of actions.")
    parser.add_argument("result", type=Path)
    parser.add_argument("--runs", type=int, help="audit so many runs only")
    parser.add_argument("--task", help="file of a task that glbench does not ship")
    options, code = parser.parse_args(arguments), 0
    try:
        words = audit(options.result, options.runs and max(options.runs, 0), options.task)
    except VerdictError as verdict:
        code, words = verdict.args[0], [f"{'differs' if verdict.args[0] == DIFFERS else 'cannot be audited'}: {verdict.args[1]}"]
    except Exception as error:  # whatever a strange file brings
        code, words = CANNOT, [f"cannot be audited: {type(error).__name__}: {error}"]
    sys.stdout.write("\n".join(words) + "\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
