"""Making the profile of a result, while it is evaluated or afterwards from its recorded actions.

The course of all runs comes column by column from the evaluation's trace or from replayed actions, with the same bits.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from glbench.env.climate import read_air
from glbench.env.quantities import QUANTITIES, QUANTITY_NAMES
from glbench.episodes import ActionLog, Replay, Trace, chosen_rows
from glbench.episodes.definition import definition_json, task_of
from glbench.episodes.recorder import LARGEST_TRACE, bytes_a_step
from glbench.errors import EpisodeError, ResultError
from glbench.evaluation.profiles import tables
from glbench.evaluation.profiles.record import SCHEMA, VERSION, Profile, profile_path, read_profile
from glbench.evaluation.records import RecordReference, Result
from glbench.model import CONTROLS, DISTURBANCE_NAMES, STATE_NAMES
from glbench.registration import task_ids
from glbench.tasks.quantities import LIMITED

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.tasks import TaskSpec


Floats = NDArray[np.floating]
_Part = tuple[Trace, Sequence[int]]
"""A trace, and the runs that it holds."""


@dataclass(frozen=True)
class Column:
    """One column of a profile: ``name``, ``unit``, ``meaning``, and whether its steps are averaged or added up."""

    name: str
    unit: str
    meaning: str
    kind: Literal["level", "amount"]


CONTROL_COLUMNS = tuple(Column(control.name, "-", control.meaning, "level") for control in CONTROLS)
CLIMATE_COLUMNS = (
    Column("air_temperature", "degC", "air temperature at the end of the step", "level"),
    Column("co2", "ppm", "CO2 of the indoor air at the end of the step", "level"),
    Column("relative_humidity", "%", "relative humidity of the indoor air at the end of the step", "level"),
)
PIPE = Column("pipe_temperature", "degC", "temperature of the rail pipes", "level")
_WANTED = ("fruit_fresh", "heat", "electricity", "co2_dosed", "epi", "penalty", "reward")
AMOUNTS = tuple(Column(q.name, q.unit, q.meaning, "amount") for q in QUANTITIES if q.name in _WANTED)
COLUMNS = (*CONTROL_COLUMNS, *CLIMATE_COLUMNS, PIPE, *AMOUNTS)
LIMITS = tuple(q for q in QUANTITIES if q.name.startswith("hours_outside_"))
WEATHER_COLUMNS = (
    Column("global_radiation", "W m-2", "sun and sky on a horizontal plane outside", "level"),
    Column("outdoor_temperature", "degC", "air outside", "level"),
    Column("outdoor_relative_humidity", "%", "relative humidity outside", "level"),
    Column("wind_speed", "m s-1", "wind speed", "level"),
)
"""The same for all agents of a task."""


@dataclass(frozen=True, eq=False)
class Course:
    """Columns ``(steps, n)`` float32 of ``n`` runs; what lies behind a run's ``lengths`` ``(n,)`` was not simulated.

    ``outside`` holds, by limit, whether it was broken ``(steps, n)``; ``weather`` columns are ``(steps,)``.
    """

    columns: Mapping[str, Floats]
    outside: Mapping[str, NDArray[np.bool_]]
    weather: Mapping[str, Floats]
    lengths: NDArray[np.int64]


def course_of(task: TaskSpec, log: ActionLog, trace: Trace | None, kernel: Stepper | None = None) -> Course:
    """The course of the runs of ``log``: from the ``trace`` of all of them, or by replaying, with the same bits.

    Raises
    ------
    ActionError
        When a recorded action is none of the task's.
    """
    lengths = np.array([run.steps for run in log.runs])
    traced: Iterable[_Part] = [(trace, range(len(lengths)))] if trace is not None else _replayed(task, log, kernel)
    parts = [_read(part, lengths[list(rows)]) for part, rows in traced]
    joined = {name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]}
    return Course(
        columns={column.name: joined[column.name] for column in COLUMNS},
        outside={limit.name: joined[limit.name] > 0 for limit in LIMITS},
        weather=_outside_air(task),
        lengths=lengths,
    )


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


def _read(trace: Trace, lengths: NDArray[np.int64]) -> dict[str, Floats]:
    """Columns of a trace, float32; steps that a run did not take are 0."""
    named: dict[str, Floats] = {column.name: trace.u[:, :, i] for i, column in enumerate(CONTROL_COLUMNS)}
    named |= {name: trace.air[1:, i] for i, name in enumerate(LIMITED)}
    named[PIPE.name] = trace.x[1:, :, STATE_NAMES.index("tPipe")]
    quantities = (*(column.name for column in AMOUNTS), *(limit.name for limit in LIMITS))
    named |= {name: trace.quantities[:, QUANTITY_NAMES.index(name)] for name in quantities}
    taken = np.arange(len(trace.u))[:, None] < lengths
    return {name: np.where(taken, values, 0.0).astype(np.float32) for name, values in named.items()}


def _outside_air(task: TaskSpec) -> dict[str, Floats]:
    values = task.disturbances(extra_rows=task.observation.forecast_steps).values[: task.steps]
    outside = {name: values[:, DISTURBANCE_NAMES.index(name)] for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")}
    humidity = read_air(outside["tOut"], outside["co2Out"], outside["vpOut"])[2]
    series = (outside["iGlob"], outside["tOut"], humidity, outside["wind"])
    return {column.name: one.astype(np.float32) for column, one in zip(WEATHER_COLUMNS, series, strict=True)}


_DAY_DIGITS, _SEASON_DIGITS, _HOUR_DIGITS, _COURSE_DIGITS = 3, 3, 4, 2
_BY_HOUR_OF_DAY = ("fruit_fresh", "heat", "electricity", "co2_dosed", "penalty", "reward")
_WORST_RUN = (*CONTROL_COLUMNS, *CLIMATE_COLUMNS, PIPE, *(c for c in AMOUNTS if c.name in ("fruit_fresh", "epi", "penalty")))  # fmt: skip


def make_profile(
    task: TaskSpec,
    result: Result,
    log: ActionLog,
    trace: Trace | None,
    kernel: Stepper | None = None,
) -> Profile:
    """The profile of ``result``, from the ``trace`` of its evaluation or by replaying its recorded actions, with the same bytes."""
    made = _Made(task, course_of(task, log, trace, kernel))
    values = result.values(task.evaluation.metric)
    (best,), (worst,) = (chosen_rows((word,), log.seeds, values) for word in ("best", "worst"))
    return Profile(
        {
            "schema": SCHEMA,
            "schema_version": VERSION,
            "results_digest": result.results_digest,
            "task": json.loads(definition_json(task)),
            "columns": {c.name: {"unit": c.unit, "meaning": c.meaning, "kind": c.kind} for c in COLUMNS},
            "seeds": {"all": list(log.seeds), "best": log.seeds[best], "worst": log.seeds[worst]},
            "weather": made.weather(),
            "day": made.day(),
            "season": made.season(best, worst),
            "calendar": made.calendar(),
            "worst": made.worst(worst),
            "hours": made.hours(),
        }
    )


def profiled(
    task: TaskSpec, result: Result, path: Path, log: ActionLog, trace: Trace | None, kernel: Stepper | None = None
) -> tuple[Result, Profile]:
    """The profile of ``result``, and the result that names it; ``path`` is where the result will lie."""
    profile = make_profile(task, result, log, trace, kernel)
    reference = RecordReference(file=profile_path(path).name, digest=profile.digest)
    return result.model_copy(update={"profile": reference}), profile


def load_profile(result: Result, path: Path) -> Profile | None:
    """The profile of ``result``, which lies at ``path``; ``None`` when there is none, or only one of an earlier result.

    Raises
    ------
    ResultError
        When the profile is damaged, is not the one that the result names, or does not fit the result.
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
        msg = f"{file} does not fit {path.name}: {misfit}. Delete it and run `glbench report --complete`."
        raise ResultError(msg)
    return profile


def _misfit(result: Result, profile: Profile) -> str:
    """What of a profile, whose numbers have the right kind, is not of the result's runs, days and hours; empty if all is."""
    document, task = profile.document, result.task
    seeds = document["seeds"]
    if seeds["all"] != [run.seed for run in result.runs] or not {seeds["best"], seeds["worst"]} <= set(seeds["all"]):
        return "its seeds are others"
    if task.id not in task_ids():
        try:
            if task_of(profile.text_of_task).id != task.id:
                return "its task is another one"
        except EpisodeError as error:
            return str(error).rstrip(".")
    if (task.steps * task.step_seconds) % tables.SECONDS_A_DAY or tables.SECONDS_A_DAY % task.step_seconds:
        return "the result's steps do not fill days"
    a_day = round(tables.SECONDS_A_DAY / task.step_seconds)
    slots, days = a_day // tables.steps_a_slot(task.step_seconds), task.steps // a_day
    of_day, hours = tables.hours(a_day, task.step_seconds), tables.hours(task.steps, task.step_seconds)
    every, weather = {c.name for c in COLUMNS}, {c.name for c in WEATHER_COLUMNS}
    day, season, outside = document["day"], document["season"], document["weather"]
    parts = {
        "day": (day["columns"], every, (len(tables.QUANTILES), slots)),
        "season": (season["columns"], every, (3, days)),
        "calendar": (
            document["calendar"],
            {limit.name.removeprefix("hours_outside_") for limit in LIMITS},
            (days, of_day),
        ),
        "worst": (document["worst"], {c.name for c in _WORST_RUN}, (hours,)),
        "hours": (document["hours"], set(_BY_HOUR_OF_DAY), (of_day, len(result.runs))),
        "weather of the day": (outside["day"], weather, (len(tables.QUANTILES), slots)),
        "weather of the season": (outside["season"]["columns"], weather, (3, days)),
        "weather by hour": (outside["hours"], weather, (hours,)),
    }
    for name, (columns, names, shape) in parts.items():
        if set(columns) != names or any(not _has_shape(one["values"], shape) for one in columns.values()):
            return f"its '{name}' has other columns, days or hours"
    return ""


def _has_shape(values: list[Any], shape: tuple[int, ...]) -> bool:
    return len(values) == shape[0] and (len(shape) == 1 or all(len(row) == shape[1] for row in values))


class _Made:
    """The parts of a profile, made from the course of all runs."""

    def __init__(self, task: TaskSpec, course: Course) -> None:
        self._course, self._lengths, self._seconds = course, course.lengths, task.step_seconds
        self._a_day, self._a_slot = round(tables.SECONDS_A_DAY / self._seconds), tables.steps_a_slot(self._seconds)

    def day(self) -> dict[str, Any]:
        """By time of day: levels as they are, amounts an hour."""
        scale = {"level": 1.0, "amount": 3600.0 / self._seconds}
        columns = {
            c.name: tables.pack(self._typical(self._course.columns[c.name], self._lengths) * scale[c.kind], _DAY_DIGITS)
            for c in COLUMNS
        }
        return {
            "slot_seconds": self._a_slot * self._seconds,
            "quantiles": list(tables.QUANTILES),
            "columns": columns,
        }

    def season(self, best: int, worst: int) -> dict[str, Any]:
        """By day: means of levels, totals of amounts; the median over the runs, the best and the worst run."""
        columns = {}
        for c in COLUMNS:
            days = tables.by_day(self._course.columns[c.name], self._lengths, self._a_day, add=c.kind == "amount")
            lines = np.stack([tables.middle_run(days), days[:, best], days[:, worst]])
            columns[c.name] = tables.pack(lines, _SEASON_DIGITS)
        return {"lines": ["median", "best", "worst"], "columns": columns}

    def calendar(self) -> dict[str, Any]:
        """By day and hour of day: minutes outside each limit, mean over the runs, in tenths."""
        return {
            name.removeprefix("hours_outside_"): tables.pack(
                tables.calendar(outside, self._lengths, self._a_day, self._seconds), 2
            )
            for name, outside in self._course.outside.items()
        }

    def worst(self, run: int) -> dict[str, Any]:
        """Hour by hour through the ``run`` that earned the smallest metric."""
        length = int(self._lengths[run])
        return {
            c.name: self._hourly(self._course.columns[c.name][:, run], length, add=c.kind == "amount")
            for c in _WORST_RUN
        }

    def hours(self) -> dict[str, Any]:
        """By hour of day and run: sums over the whole season."""
        sums = {
            name: tables.by_hour_of_day(self._course.columns[name], self._a_day, self._seconds)
            for name in _BY_HOUR_OF_DAY
        }
        return {name: tables.pack(values, _HOUR_DIGITS) for name, values in sums.items()}

    def weather(self) -> dict[str, Any]:
        """Weather by time of day, by day (mean, lowest, highest) and by hour."""
        day, season, hours = {}, {}, {}
        for name, series in self._course.weather.items():
            everything = np.array([len(series)])
            day[name] = tables.pack(self._typical(series[:, None], everything), _DAY_DIGITS)
            days = series.reshape(-1, self._a_day)
            lines = np.stack([days.mean(axis=1, dtype=np.float64), days.min(axis=1), days.max(axis=1)])
            season[name] = tables.pack(lines, _SEASON_DIGITS)
            hours[name] = self._hourly(series, len(series), add=False)
        return {
            "columns": {c.name: {"unit": c.unit, "meaning": c.meaning} for c in WEATHER_COLUMNS},
            "day": day,
            "season": {"lines": ["mean", "lowest", "highest"], "columns": season},
            "hours": hours,
        }

    def _typical(self, values: Floats, lengths: NDArray[np.int64]) -> Floats:
        return tables.typical_day(values, lengths, self._a_day, self._a_slot)

    def _hourly(self, values: Floats, length: int, *, add: bool) -> tables.Packed:
        return tables.pack(tables.by_hour(values, length, self._seconds, add=add), _COURSE_DIGITS)
