"""Making the profile of a result, while it is evaluated or afterwards from its recorded actions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glbench.episodes import ActionLog, Trace, chosen_rows
from glbench.episodes.definition import definition_json
from glbench.errors import ResultError
from glbench.evaluation.profiles import tables
from glbench.evaluation.profiles.course import (
    AMOUNTS,
    CLIMATE_COLUMNS,
    COLUMNS,
    CONTROL_COLUMNS,
    LIMITS,
    PIPE,
    WEATHER_COLUMNS,
    Course,
    course_of,
)
from glbench.evaluation.profiles.record import SCHEMA, VERSION, Profile, profile_path, read_profile
from glbench.evaluation.records import RecordReference, Result

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.tasks import TaskSpec

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
        When the profile is damaged, or is not the one that the result names.
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
    return profile


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
