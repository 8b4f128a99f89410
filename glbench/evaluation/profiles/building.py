"""Making the profile of a result, while it is evaluated or afterwards from its recorded actions.

The course of all runs comes column by column from the evaluation's trace or from replayed actions, with the same bits.
"""

from __future__ import annotations

import datetime as dt
import json
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from glbench import quantities
from glbench.env.accounts import flow_amounts
from glbench.env.air import read_air
from glbench.env.camera import run_scenes
from glbench.env.kernels import Stepper
from glbench.env.scenario import RunScenarios, run_weather
from glbench.episodes import ActionLog, Replay, Trace, chosen_rows
from glbench.episodes.header import definition_json, task_of
from glbench.episodes.recorder import LARGEST_TRACE, bytes_a_step
from glbench.errors import GlbenchError, ResultError, refuse
from glbench.evaluation.profiles import record
from glbench.evaluation.profiles.record import SCHEMA, VERSION, Profile, profile_path, read_profile
from glbench.evaluation.records import RecordReference, Result
from glbench.model import Air, Horizon
from glbench.model.equipment import BUFFER, ENERGY_FLOWS, Equipment, lacks_energy
from glbench.model.greenlight import JOULES_PER_KWH
from glbench.model.model import ObservedColumn
from glbench.registration import task_ids
from glbench.tasks import TaskSpec, published_task
from glbench.tasks.ledger import FLOW, LedgerItem
from glbench.weather import COLUMNS as WEATHER

Floats = NDArray[np.floating]
_Part = tuple[Trace, Sequence[int]]  # A trace, and the runs that it holds


@dataclass(frozen=True)
class ProfileColumn:
    """One column of a profile: ``name``, ``unit``, ``meaning``, and whether its steps are averaged or added up."""

    name: str
    unit: str
    meaning: str
    kind: Literal["level", "amount"]


@dataclass(frozen=True)
class Columns:
    """The columns of a task's profiles.

    ``controls``, ``climate`` (what the model shows of it, as ``observed``), ``light`` (what comes in a step, as ``rates``) and ``amounts``
    make up ``all``; ``limits`` are quantities that are hours outside a limit. ``worst`` are shown of the worst run, ``by_hour`` are names
    of amounts that are summed by hour of day.
    """

    controls: tuple[ProfileColumn, ...]
    climate: tuple[ProfileColumn, ...]
    observed: tuple[ObservedColumn, ...]
    light: tuple[ProfileColumn, ...]
    rates: tuple[ObservedColumn, ...]
    amounts: tuple[ProfileColumn, ...]
    limits: tuple[str, ...]
    worst: tuple[ProfileColumn, ...]
    by_hour: tuple[str, ...]

    @property
    def all(self) -> tuple[ProfileColumn, ...]:
        """Every column of the runs' course."""
        return (*self.controls, *self.climate, *self.light, *self.amounts)


@lru_cache(maxsize=32)
def columns_of(task: TaskSpec) -> Columns:
    """The columns of profiles of ``task``, from its model, ledger and limits."""
    model, ledger = task.model_value, task.ledger
    controls = tuple(ProfileColumn(control.name, "-", control.meaning, "level") for control in model.controls)
    horizon = Horizon(task.steps, task.step_seconds, task.parameters_by_name())
    observed, deficits, rates = (model.observed(module, horizon) or () for module in _OBSERVATIONS)
    if not task.conventions.profiles_deficits:
        deficits, rates = (), ()
    observed = (*observed, *deficits)
    meanings = {state.name: state.meaning for state in model.states}
    climate = tuple(
        ProfileColumn(one.name, one.unit, _AIR.get(one.source) or meanings.get(one.source, one.meaning), "level") for one in observed
    )
    light = tuple(ProfileColumn(one.name.removesuffix(_TODAY), one.unit, one.meaning.partition(",")[0], "amount") for one in rates)
    earned = {item.amount for item in ledger.earned}
    flows = {item.amount for item in ledger.items}
    amounts = tuple(
        ProfileColumn(q.name, q.unit, q.meaning, "amount") for q in task.quantities if q.name in {*flows, "epi", "penalty", "reward"}
    )
    return Columns(
        controls,
        climate,
        observed,
        light,
        rates,
        amounts,
        tuple(q.name for q in task.quantities if q.name.startswith(quantities.OUTSIDE)),
        (*controls, *climate, *(c for c in amounts if c.name in {*earned, "epi", "penalty"})),
        tuple(c.name for c in amounts if c.name != "epi"),
    )


_OBSERVATIONS = ("indoor_climate", "vapour_deficit", "light_today")
"""Observation modules that profiles show, whether the task's agents observe them or not."""
_TODAY = "_today"  # What the names of sums since midnight end with; a profile has the amount of each step
_AIR = {name: f"{entry.meaning} at the end of the step" for name, entry in quantities.AIR.items()}
"""What is measured in the main air, in the order of the simulation."""
WEATHER_COLUMNS = tuple(
    ProfileColumn(name, quantities.OUTDOOR[name].unit, quantities.OUTDOOR[name].meaning, "level")
    for name in ("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "wind_speed")
)
"""The same for all agents of a task."""


@dataclass(frozen=True, eq=False)
class RunSeries:
    """Columns ``(steps, n)`` float32 of ``n`` runs; what lies behind a run's ``lengths`` ``(n,)`` was not simulated.

    ``outside`` holds, by limit, whether it was broken ``(steps, n)``; ``weather`` columns are ``(steps, n)``, or ``(steps, 1)`` where all
    runs have the same. ``starts`` are the runs' first days, where they differ. ``energy`` are further columns of an energy system.
    """

    columns: Mapping[str, Floats]
    outside: Mapping[str, NDArray[np.bool_]]
    weather: Mapping[str, Floats]
    lengths: NDArray[np.int64]
    starts: tuple[str, ...] = ()
    energy: Mapping[str, Floats] = field(default_factory=dict)


def _replayed(task: TaskSpec, log: ActionLog, kernel: Stepper | None) -> Iterator[_Part]:
    """All runs again, as many at a time as fit into memory."""
    together = max(1, LARGEST_TRACE // (task.steps * bytes_a_step(task)))
    for first in range(0, len(log.runs), together):
        rows = range(first, min(first + together, len(log.runs)))
        replay = Replay(task, log, rows, kernel)
        trace = Trace(replay.simulation)
        for outcome in replay.steps():
            trace.add(replay.simulation, outcome)
        yield trace, rows


def _read(task: TaskSpec, trace: Trace, lengths: NDArray[np.int64], acting: Floats) -> dict[str, Floats]:
    """Columns of a trace, float32, of runs on which ``acting`` ``(steps, n, d)`` acts; steps that a run did not take are 0."""
    columns, model = columns_of(task), task.model_value
    named: dict[str, Floats] = {column.name: trace.u[:, :, i] for i, column in enumerate(columns.controls)}
    for one in columns.observed:
        if one.of is not None:
            states = model.State(*np.moveaxis(trace.x[1:], 2, 0))
            values = np.broadcast_to(one.of(states, _nominal(task)), trace.x.shape[1:2])
        elif one.of_air is not None:
            values = one.of_air(Air(*np.moveaxis(trace.air[1:], 1, 0)))
        elif one.source in _AIR:
            values = trace.air[1:, list(_AIR).index(one.source)]
        else:
            values = trace.x[1:, :, model.state_index(one.source)]
        named[one.name] = values if one.factor == 1.0 else values * one.factor
    if columns.light:
        u, d = model.Controls(*np.moveaxis(trace.u, 2, 0)), model.Disturbances(*np.moveaxis(acting, 2, 0))
        for column, one in zip(columns.light, columns.rates, strict=True):
            assert one.today is not None
            named[column.name] = np.broadcast_to(one.today(u, d, _nominal(task)), trace.u.shape[:2]) * task.step_seconds
    rows = {quantity.name: row for row, quantity in enumerate(task.quantities)}
    counted = (*(column.name for column in columns.amounts), *columns.limits)
    named |= {name: trace.quantities[:, rows[name]] for name in counted}
    if energy_columns(task):
        named |= {_ENERGY + name: values for name, values in _energy(task, trace).items()}
    running = np.arange(len(trace.u))[:, None] < lengths
    return {name: np.where(running, values, 0.0).astype(np.float32) for name, values in named.items()}


_ENERGY = "energy/"  # What columns of ``RunSeries.energy`` are called before they are apart
_BURNT, _LOST, _LEVEL = "engine_gas", "heat_lost", "stored"
"""Gas of the engine, heat that the buffer loses, and heat in it at the end of a step."""
_AMOUNTS = (*ENERGY_FLOWS, _BURNT, _LOST)
_KWH = {"kWh m-2": 1.0, "J m-2": 1 / JOULES_PER_KWH, "MJ m-2": 1e6 / JOULES_PER_KWH, "kg m-2": 1.0}
"""From the unit of a flow to kWh; CO2 stays in kg."""


def energy_columns(task: TaskSpec) -> tuple[str, ...]:
    """Of an energy system its flows and its level [kWh m-2; kg m-2], and the money of prices that change. Nothing where there is none."""
    return () if lacks_energy(task.model_value) else (*_AMOUNTS, _LEVEL, *(item.name for item in _changing(task)))


def _changing(task: TaskSpec) -> list[LedgerItem]:
    """Items of the energy system whose prices change."""
    items = task.ledger.items
    return [item for item in items if isinstance(item.price, str) and item.valued == FLOW and item.flow in ENERGY_FLOWS]


def _energy(task: TaskSpec, trace: Trace) -> dict[str, Floats]:
    """The columns of the energy system ``(steps, n)``."""
    units = {flow.name: flow.unit for flow in task.model_value.flows()}
    flows = {name: amount * _KWH[units[name]] for name, amount in flow_amounts(task, ENERGY_FLOWS, trace.x, trace.u).items()}
    level = trace.x[..., task.model_value.state_index(BUFFER)] * _KWH["MJ m-2"]
    equipment = Equipment.of(task.model_value, task.parameters_by_name())
    days = task.step_seconds / record.SECONDS_A_DAY
    rows = {quantity.name: row for row, quantity in enumerate(task.quantities)}
    money = {item.name: trace.quantities[:, rows[item.name]] for item in _changing(task)}
    return {
        **flows,
        _BURNT: flows["electricity_made"] / equipment.eta_engine,
        _LOST: (level[:-1] + level[1:]) / 2 * days / equipment.tau,
        _LEVEL: level[1:],
        **money,
    }


def _nominal(task: TaskSpec) -> Any:
    return task.model_value.Parameters(*task.parameters().tolist())


class _Seasons:
    """The weather of each run's own season, as one column where it is the same for all, and the first days where they differ."""

    def __init__(self, task: TaskSpec, seeds: Sequence[int]) -> None:
        scenarios = RunScenarios(task)
        pool, scenes, steps = scenarios.pool, scenarios.draw(seeds), np.arange(task.steps)
        same = bool((scenes.days == scenes.days[0]).all())
        rows = scenes.days[: 1 if same else None, steps // pool.day] + steps % pool.day
        self._values = pool.values[rows.T]
        first_days: list[str] = []
        for row in [] if same else scenes.first.tolist():
            season = bisect_right(pool.seasons, row) - 1
            late = dt.timedelta(days=(row - pool.seasons[season]) // pool.day)
            first_days.append((scenarios.scenario.seasons[season].start + late).isoformat())
        self.starts = tuple(first_days)

    def values(self, runs: Sequence[int]) -> Floats:
        """What acts on some of the runs ``(steps, n, d)``."""
        values: Floats = self._values[:, list(runs)] if self.starts else self._values
        return values

    def weather(self) -> dict[str, Floats]:
        """The columns of the weather."""
        values = self._values
        radiation, temperature, vapour, co2, wind = (
            values[..., WEATHER.index(name)] for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")
        )
        humidity = read_air(temperature.ravel(), co2.ravel(), vapour.ravel())[2].reshape(temperature.shape)
        series = (radiation, temperature, humidity, wind)
        return {column.name: one.astype(np.float32) for column, one in zip(WEATHER_COLUMNS, series, strict=True)}


_DAY_DIGITS, _SEASON_DIGITS, _HOUR_DIGITS, _COURSE_DIGITS = 3, 3, 4, 2


def make_profile(task: TaskSpec, result: Result, log: ActionLog, trace: Trace | None, kernel: Stepper | None = None) -> Profile:
    """The profile of ``result``, from the ``trace`` of its evaluation or by replaying its recorded actions, with the same bytes.

    Raises ``ActionError`` when a recorded action is none of the task's.
    """
    lengths = np.array([run.steps for run in log.runs])
    traced: Iterable[_Part] = [(trace, range(len(lengths)))] if trace is not None else _replayed(task, log, kernel)
    seasons, parts, pictures = _Seasons(task, log.seeds), [], {}
    values = result.values(task.evaluation.metric)
    (best,), (worst,) = (chosen_rows((word,), log.seeds, values) for word in ("best", "worst"))
    for part, rows in traced:
        with np.errstate(all="ignore"):  # steps after the end of a run have no numbers
            parts.append(_read(task, part, lengths[list(rows)], seasons.values(rows)))
        if task.camera is not None and worst in rows:
            states, hours = part.x[: lengths[worst] + 1, worst - rows[0]], run_weather(task, log.seeds[worst]).hour_of_day
            scenes = run_scenes(task, log.seeds[worst], states, hours[: len(states)])
            pictures = {"pictures": scenes[task.steps_per_day - 1 :: 7 * task.steps_per_day].tolist()}
    joined = {name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]}
    course = RunSeries(
        columns={column.name: joined[column.name] for column in columns_of(task).all},
        outside={limit: joined[limit] > 0 for limit in columns_of(task).limits},
        weather=seasons.weather(),
        lengths=lengths,
        starts=seasons.starts,
        energy={name: joined[_ENERGY + name] for name in energy_columns(task)},
    )
    builder = _Builder(task, course)
    seeds = {"all": list(log.seeds), "best": log.seeds[best], "worst": log.seeds[worst]}
    starts = {"starts": list(builder.starts)} if builder.starts else {}
    return Profile(
        {
            "schema": SCHEMA,
            "schema_version": VERSION,
            "results_digest": result.results_digest,
            "task": json.loads(definition_json(task)),
            "columns": {c.name: {"unit": c.unit, "meaning": c.meaning, "kind": c.kind} for c in builder.columns.all},
            "seeds": {**seeds, **starts},
            "weather": builder.weather(worst),
            "day": builder.day(),
            "season": builder.season(best, worst),
            "calendar": builder.calendar(),
            "worst": builder.worst(worst),
            "hours": builder.hours(),
            **builder.energy(task),
            **pictures,
        }
    )


def profiled(task: TaskSpec, result: Result, path: Path, log: ActionLog, trace: Trace | None) -> tuple[Result, Profile]:
    """The profile of ``result``, and the result that names it; ``path`` is where the result will lie."""
    profile = make_profile(task, result, log, trace)
    reference = RecordReference(file=profile_path(path).name, digest=profile.digest)
    return result.model_copy(update={"profile": reference}), profile


def load_profile(result: Result, path: Path) -> Profile | None:
    """The profile of ``result``, which is at ``path``; ``None`` when there is none, or only one of an earlier result.

    Raises ``ResultError`` when the profile is damaged, is not the one that the result names, or does not fit the result.
    """
    file = profile_path(path)
    if not file.exists():
        return None
    profile = read_profile(file)
    if profile.document.get("results_digest") != result.results_digest:
        return None
    if result.profile is not None and profile.digest != result.profile.digest:
        msg = (
            f"{file} is not the profile that {path.name} names (digest {profile.digest[:12]}..., "
            f"named {result.profile.digest[:12]}...): it was changed. Delete it and run `glbench report --complete`."
        )
        raise ResultError(msg)
    misfit = _misfit(result, profile)
    if misfit:
        refuse(f"{file} does not fit {path.name}: {misfit}. Delete it and run `glbench report --complete`.", ResultError)
    return profile


def _misfit(result: Result, profile: Profile) -> str:
    """What of a profile, whose numbers have the right kind, is not of the result's runs, days and hours; empty if all is."""
    document, task = profile.document, result.task
    seeds = document["seeds"]
    if seeds["all"] != [run.seed for run in result.runs] or not {seeds["best"], seeds["worst"]} <= set(seeds["all"]):
        return "its seeds are others"
    try:
        spec = (published_task(task.id) if task.id in task_ids() else task_of(profile.text_of_task)).scored_in(task.split)
        if spec.id != task.id:
            return "its task is another one"
        columns = columns_of(spec)
    except GlbenchError as error:
        return str(error).rstrip(".")
    if len(seeds.get("starts", seeds["all"])) != len(seeds["all"]):
        return "its first days are not those of the runs"
    if (task.steps * task.step_seconds) % record.SECONDS_A_DAY or record.SECONDS_A_DAY % task.step_seconds:
        return "the result's steps do not fill days"
    a_day = round(record.SECONDS_A_DAY / task.step_seconds)
    slots, days = a_day // record.steps_a_slot(task.step_seconds), task.steps // a_day
    of_day, hours = record.hours(a_day, task.step_seconds), record.hours(task.steps, task.step_seconds)
    every, weather = {c.name for c in columns.all}, {c.name for c in WEATHER_COLUMNS}
    day, season, outside = document["day"], document["season"], document["weather"]
    parts = {
        "day": (day["columns"], every, (len(record.QUANTILES), slots)),
        "season": (season["columns"], every, (3, days)),
        "calendar": (document["calendar"], {limit.removeprefix(quantities.OUTSIDE) for limit in columns.limits}, (days, of_day)),
        "worst": (document["worst"], {c.name for c in columns.worst}, (hours,)),
        "hours": (document["hours"], set(columns.by_hour), (of_day, len(result.runs))),
        "weather of the day": (outside["day"], weather, (len(record.QUANTILES), slots)),
        "weather of the season": (outside["season"]["columns"], weather, (3, days)),
        "weather by hour": (outside["hours"], weather, (hours,)),
    }
    if "energy" in document:  # profiles of earlier versions have none
        content = document["energy"]
        parts["energy"] = (content["columns"], {*_AMOUNTS, _LEVEL} & {*energy_columns(spec)}, (of_day,))
        parts["prices of the energy"] = (content["prices"], {item.name for item in _changing(spec)}, (of_day,))
    scenes = 0 if spec.picture_library is None else len(spec.picture_library.seeds)
    if not all(scene in range(scenes) for scene in document.get("pictures", ())):
        return "its pictures are none of the library's"
    for name, (content, names, shape) in parts.items():
        lists = [one["values"] for one in content.values()]
        widths = {len(row) for values in lists for row in values} if len(shape) == 2 else set()
        if set(content) != names or {len(values) for values in lists} - {shape[0]} or widths - set(shape[1:]):
            return f"its '{name}' has other columns, days or hours"
    return ""


class _Builder:
    """The parts of a profile, made from the course of all runs."""

    def __init__(self, task: TaskSpec, course: RunSeries) -> None:
        self.columns, self.starts = columns_of(task), course.starts
        self._course, self._lengths, self._seconds = course, course.lengths, task.step_seconds
        self._a_day, self._a_slot = round(record.SECONDS_A_DAY / self._seconds), record.steps_a_slot(self._seconds)

    def day(self) -> dict[str, Any]:
        """By time of day: levels as they are, amounts an hour."""
        scale = {"level": 1.0, "amount": 3600.0 / self._seconds}
        columns = {
            c.name: record.pack(self._typical(self._course.columns[c.name], self._lengths) * scale[c.kind], _DAY_DIGITS)
            for c in self.columns.all
        }
        return {"slot_seconds": self._a_slot * self._seconds, "quantiles": list(record.QUANTILES), "columns": columns}

    def season(self, best: int, worst: int) -> dict[str, Any]:
        """By day: means of levels, totals of amounts; the median over the runs, the best and the worst run."""
        columns = {}
        for c in self.columns.all:
            days = record.by_day(self._course.columns[c.name], self._lengths, self._a_day, add=c.kind == "amount")
            lines = np.stack([record.middle_run(days), days[:, best], days[:, worst]])
            columns[c.name] = record.pack(lines, _SEASON_DIGITS)
        return {"lines": ["median", "best", "worst"], "columns": columns}

    def calendar(self) -> dict[str, Any]:
        """By day and hour of day: minutes outside each limit, mean over the runs, in tenths."""
        return {
            name.removeprefix(quantities.OUTSIDE): record.pack(record.calendar(outside, self._lengths, self._a_day, self._seconds), 2)
            for name, outside in self._course.outside.items()
        }

    def worst(self, run: int) -> dict[str, Any]:
        """Hour by hour through the ``run`` that earned the smallest metric."""
        length = int(self._lengths[run])
        return {c.name: self._hourly(self._course.columns[c.name][:, run], length, add=c.kind == "amount") for c in self.columns.worst}

    def hours(self) -> dict[str, Any]:
        """By hour of day and run: sums over the whole season."""
        sums = {name: record.by_hour_of_day(self._course.columns[name], self._a_day, self._seconds) for name in self.columns.by_hour}
        return {name: record.pack(values, _HOUR_DIGITS) for name, values in sums.items()}

    def energy(self, task: TaskSpec) -> dict[str, Any]:
        """Of an energy system by hour of day, mean over days and runs: amounts, and prices that change, null where nothing flowed."""
        columns = self._course.energy
        if not columns:
            return {}
        steps = next(iter(columns.values())).shape[0]
        running = (np.arange(steps)[:, None] < self._lengths).astype(np.float64)
        counts = self._of_day(running)
        an_hour = 3600.0 / self._seconds
        flows = {name: self._of_day(columns[name]) / counts * (1.0 if name == _LEVEL else an_hour) for name in (*_AMOUNTS, _LEVEL)}
        prices = {}
        for item in _changing(task):
            amount = self._of_day(self._course.columns[item.amount])
            prices[item.name] = self._of_day(columns[item.name]) / np.where(amount == 0.0, np.nan, amount)
        return {
            "energy": {
                "columns": {name: record.pack(values, _HOUR_DIGITS) for name, values in flows.items()},
                "prices": {name: record.pack(values, _HOUR_DIGITS) for name, values in prices.items()},
            }
        }

    def _of_day(self, values: Floats) -> Floats:
        """Sums by hour of day over all days and runs ``(hours,)``."""
        return np.asarray(record.by_hour_of_day(values, self._a_day, self._seconds).sum(axis=1))

    def weather(self, run: int) -> dict[str, Any]:
        """Weather by time of day and by day (mean, lowest, highest) of all runs, and by hour of one ``run``."""
        day, season, hours = {}, {}, {}
        for name, series in self._course.weather.items():
            steps, n = series.shape
            day[name] = record.pack(self._typical(series, np.full(n, steps)), _DAY_DIGITS)
            days = series.T.reshape(n, -1, self._a_day).swapaxes(0, 1).reshape(-1, n * self._a_day)
            lines = np.stack([days.mean(axis=1, dtype=np.float64), days.min(axis=1), days.max(axis=1)])
            season[name] = record.pack(lines, _SEASON_DIGITS)
            hours[name] = self._hourly(np.ascontiguousarray(series[:, run if n > 1 else 0]), steps, add=False)
        return {
            "columns": {c.name: {"unit": c.unit, "meaning": c.meaning} for c in WEATHER_COLUMNS},
            "day": day,
            "season": {"lines": ["mean", "lowest", "highest"], "columns": season},
            "hours": hours,
        }

    def _typical(self, values: Floats, lengths: NDArray[np.int64]) -> Floats:
        return record.typical_day(values, lengths, self._a_day, self._a_slot)

    def _hourly(self, values: Floats, length: int, *, add: bool) -> record.Packed:
        return record.pack(record.by_hour(values, length, self._seconds, add=add), _COURSE_DIGITS)
