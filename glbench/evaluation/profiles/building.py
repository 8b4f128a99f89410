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

from glbench.env.climate import AirReader
from glbench.env.quantities import QUANTITIES, QUANTITY_NAMES
from glbench.episodes import ActionLog, Replay, Trace, chosen_rows
from glbench.episodes.definition import definition_json, task_of
from glbench.episodes.recorder import BYTES_A_STEP, LARGEST_TRACE
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


def _amounts() -> tuple[Column, ...]:
    wanted = ("fruit_fresh", "heat", "electricity", "co2_dosed", "epi", "penalty", "reward")
    return tuple(Column(q.name, q.unit, q.meaning, "amount") for q in QUANTITIES if q.name in wanted)


CONTROL_COLUMNS = tuple(Column(control.name, "-", control.meaning, "level") for control in CONTROLS)
CLIMATE_COLUMNS = (
    Column("air_temperature", "degC", "air temperature at the end of the step", "level"),
    Column("co2", "ppm", "CO2 of the indoor air at the end of the step", "level"),
    Column("relative_humidity", "%", "relative humidity of the indoor air at the end of the step", "level"),
)
PIPE = Column("pipe_temperature", "degC", "temperature of the rail pipes", "level")
AMOUNTS = _amounts()
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
    together = max(1, LARGEST_TRACE // (task.steps * BYTES_A_STEP))
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
    humidity = AirReader(task.steps)(outside["tOut"], outside["co2Out"], outside["vpOut"])[2]
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
    course = course_of(task, log, trace, kernel)
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
            "weather": _weather(task, course),
            "day": _day(task, course),
            "season": _season(task, course, best, worst),
            "calendar": _calendar(task, course),
            "worst": _worst(task, course, worst),
            "hours": _hours(task, course),
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


def _a_day(task: TaskSpec) -> int:
    return round(tables.SECONDS_A_DAY / task.step_seconds)


def _day(task: TaskSpec, course: Course) -> dict[str, Any]:
    """By time of day: levels as they are, amounts an hour."""
    a_slot, a_day = tables.steps_a_slot(task.step_seconds), _a_day(task)
    an_hour = 3600.0 / task.step_seconds
    columns = {
        column.name: tables.pack(
            tables.typical_day(course.columns[column.name], course.lengths, a_day, a_slot)
            * (an_hour if column.kind == "amount" else 1.0),
            _DAY_DIGITS,
        )
        for column in COLUMNS
    }
    return {"slot_seconds": a_slot * task.step_seconds, "quantiles": list(tables.QUANTILES), "columns": columns}


def _season(task: TaskSpec, course: Course, best: int, worst: int) -> dict[str, Any]:
    """By day: means of levels, totals of amounts; the median over the runs, the best and the worst run."""
    columns = {}
    for column in COLUMNS:
        days = tables.by_day(course.columns[column.name], course.lengths, _a_day(task), add=column.kind == "amount")
        lines = np.stack([tables.middle_run(days), days[:, best], days[:, worst]])
        columns[column.name] = tables.pack(lines, _SEASON_DIGITS)
    return {"lines": ["median", "best", "worst"], "columns": columns}


def _calendar(task: TaskSpec, course: Course) -> dict[str, Any]:
    """By day and hour of day: minutes outside each limit, mean over the runs, in tenths."""
    return {
        limit.name.removeprefix("hours_outside_"): tables.pack(
            tables.calendar(course.outside[limit.name], course.lengths, _a_day(task), task.step_seconds), 2
        )
        for limit in LIMITS
    }


def _worst(task: TaskSpec, course: Course, worst: int) -> dict[str, Any]:
    """Hour by hour through the run that earned the smallest metric."""
    length = int(course.lengths[worst])
    return {
        column.name: tables.pack(
            tables.by_hour(
                course.columns[column.name][:, worst], length, task.step_seconds, add=column.kind == "amount"
            ),
            _COURSE_DIGITS,
        )
        for column in _WORST_RUN
    }


def _hours(task: TaskSpec, course: Course) -> dict[str, Any]:
    """By hour of day and run: sums over the whole season."""
    return {
        name: tables.pack(tables.by_hour_of_day(course.columns[name], _a_day(task), task.step_seconds), _HOUR_DIGITS)
        for name in _BY_HOUR_OF_DAY
    }


def _weather(task: TaskSpec, course: Course) -> dict[str, Any]:
    """Weather by time of day, by day (mean, lowest, highest) and by hour."""
    a_slot, a_day = tables.steps_a_slot(task.step_seconds), _a_day(task)
    day, season, hours = {}, {}, {}
    everything = np.array([task.steps])
    for column in WEATHER_COLUMNS:
        series = course.weather[column.name]
        day[column.name] = tables.pack(tables.typical_day(series[:, None], everything, a_day, a_slot), _DAY_DIGITS)
        days = series.reshape(-1, a_day)
        lines = np.stack([days.mean(axis=1, dtype=np.float64), days.min(axis=1), days.max(axis=1)])
        season[column.name] = tables.pack(lines, _SEASON_DIGITS)
        hours[column.name] = tables.pack(
            tables.by_hour(series, task.steps, task.step_seconds, add=False), _COURSE_DIGITS
        )
    return {
        "columns": {c.name: {"unit": c.unit, "meaning": c.meaning} for c in WEATHER_COLUMNS},
        "day": day,
        "season": {"lines": ["mean", "lowest", "highest"], "columns": season},
        "hours": hours,
    }
