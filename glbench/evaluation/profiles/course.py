"""The course of all runs: what a profile is made from, column by column, from the evaluation's trace or from replayed actions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from glbench.env.climate import read_air
from glbench.env.quantities import QUANTITIES, QUANTITY_NAMES
from glbench.episodes import ActionLog, Replay, Trace
from glbench.episodes.recorder import BYTES_A_STEP, LARGEST_TRACE
from glbench.model import CONTROLS, DISTURBANCE_NAMES, STATE_NAMES
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
        weather=_weather(task),
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


def _weather(task: TaskSpec) -> dict[str, Floats]:
    values = task.disturbances(extra_rows=task.observation.forecast_steps).values[: task.steps]
    outside = {name: values[:, DISTURBANCE_NAMES.index(name)] for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")}
    humidity = read_air(outside["tOut"], outside["co2Out"], outside["vpOut"])[2]
    series = (outside["iGlob"], outside["tOut"], humidity, outside["wind"])
    return {column.name: one.astype(np.float32) for column, one in zip(WEATHER_COLUMNS, series, strict=True)}
