"""Observations: small named parts, put side by side in the order of the task.

Names, units and bounds of the columns belong to the task (``glbench.tasks.vocabulary``) and to the model; their values are computed
here. What glbench ships is data: numbers of the run, or rows of tables. To add a part, register its columns and a function
that makes it; it is made once for a task and called after every step:

    def canopy(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
        place = task.model_value.state_index("...")
        return lambda inputs: inputs.states[:, [place]]

    register_observation(ObservationModule("canopy", "canopy temperature", columns), canopy)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glbench.env.air import AIR
from glbench.env.forecast import HOUR
from glbench.env.numpy_environments import ObservationInputs
from glbench.env.outdoor import MEASURED
from glbench.env.weather_pool import CLOCK, WeatherTables
from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.kernel.environment import Lookup
from glbench.model import ObservedColumn
from glbench.tasks import TaskSpec
from glbench.tasks.vocabulary import OBSERVATION_MODULES, ObservationModule

Source = Literal["states", "air", "weather", "controls", "counter", "clock", "schedule"]


@dataclass(frozen=True)
class Numbers:
    """Columns that are numbers of the run times factors.

    "weather" is as read, "counter" has steps taken and the step whose weather is shown, "clock" hour and day, "schedule" what comes now.
    """

    source: Source
    indices: tuple[int, ...]
    factors: tuple[float, ...]


@dataclass(frozen=True)
class Locked:
    """A column that says for how many minutes a control still stays on or off."""

    control: str


ColumnSource = Numbers | Lookup | ObservedColumn | Locked
"""Where columns come from: numbers of the run, rows of a table, a formula of the model, or the lock of a control."""

ObservationPart = Callable[[ObservationInputs], NDArray[np.floating]]
"""Columns of one module, ``(n, columns)``, finite numbers. Row i may depend on row i of the inputs only."""

CheckedObservation = Callable[[ObservationInputs, NDArray[np.bool_]], NDArray[np.floating]]
"""The same, with the rows that count: those of runs that go on, ``(n,)``."""

MakeObservation = Callable[["TaskSpec", WeatherTables], ObservationPart]

_MAKERS: dict[str, MakeObservation] = {}


def register_observation(module: ObservationModule, make: MakeObservation) -> None:
    """Make an observation module known, here and in task files. Raises ``TaskError`` when its name is taken."""
    OBSERVATION_MODULES.add(module)
    _MAKERS[module.name] = make


def python_part(name: str) -> MakeObservation | None:
    """The maker of a registered module; ``None`` for one that is data."""
    return _MAKERS.get(name)


def checked_part(task: TaskSpec, name: str, part: ObservationPart) -> CheckedObservation:
    """A registered module's part, which refuses what its columns cannot be."""
    columns = tuple(column.name for column in task.observed_by(name))

    def look(inputs: ObservationInputs, valid: NDArray[np.bool_]) -> NDArray[np.floating]:
        values = np.asarray(part(inputs))
        expected = (len(inputs.states), len(columns))
        if values.shape != expected:
            msg = (
                f"The observation module '{name}' of {task.id} returned an array of shape {values.shape}; it must be {expected}: "
                f"a row for every run, and a column each for {', '.join(columns)}."
            )
            raise TaskError(msg)
        wrong = ~np.isfinite(values) & valid[:, None]
        if wrong.any():
            row, column = (int(place) for place in np.argwhere(wrong)[0])
            msg = (
                f"The observation module '{name}' of {task.id} returned {values[row, column]} for '{columns[column]}'; "
                "it must be a finite number."
            )
            raise TaskError(msg)
        return values

    return look


def column_sources(name: str, task: TaskSpec, tables: WeatherTables) -> tuple[ColumnSource, ...]:
    """The columns of a module that is data: of the task's model, or the environment's own.

    Raises ``UnknownNameError`` for an unknown module. Raises ``TaskError`` when neither states nor air have what the model shows.
    """
    model = task.model_value
    columns = model.observed(name, task.observation_context().horizon)
    if columns is None:
        if name in _SOURCES:
            return _SOURCES[name](task, tables)
        names = (*_MAKERS, *_SOURCES, *model.observation_modules)
        refuse(f"There is no observation module called '{name}'.{did_you_mean(name, names)}", UnknownNameError)
    air = list(AIR) if model.air else []
    sources: list[ColumnSource] = []
    for column in columns:
        if column.of_air is not None and not model.air:
            refuse(f"{model.id} shows '{column.name}' of its air, and has none.", TaskError)
        if column.of is not None or column.of_air is not None or column.today is not None:
            sources.append(column)
        elif column.source in air:
            sources.append(Numbers("air", (air.index(column.source),), (column.factor,)))
        elif column.source in model.state_names:
            sources.append(Numbers("states", (model.state_index(column.source),), (column.factor,)))
        else:
            msg = f"{model.id} shows '{column.name}' of '{column.source}', which is neither one of its states nor a quantity of its air."
            raise TaskError(msg)
    return tuple(sources)


def _plain(source: Source, *factors: float) -> tuple[ColumnSource, ...]:
    return (Numbers(source, tuple(range(len(factors))), factors),)


def _ahead(task: TaskSpec, table: NDArray[np.float32]) -> tuple[ColumnSource, ...]:
    return (Lookup(table, rows=task.observation.forecast_steps, ahead=1),)


_SOURCES: dict[str, Callable[[TaskSpec, WeatherTables], tuple[ColumnSource, ...]]] = {
    "time": lambda task, tables: (Lookup(tables.clock, clocked=True),),
    "local_time": lambda task, tables: _plain("clock", *(1.0,) * len(CLOCK)),
    "controls": lambda task, tables: _plain("controls", *(capacity.at_one for capacity in task.capacities())),
    "weather": lambda task, tables: (
        (Lookup(tables.measured),) if task.outdoor_sensors is None else _plain("weather", *(1.0,) * len(MEASURED))
    ),
    "forecast": lambda task, tables: _ahead(task, tables.measured),
    "weather_forecast": lambda task, tables: (Lookup(tables.forecast, every=max(HOUR // task.weather.step_seconds, 1)),),
    "weather_window": lambda task, tables: (Lookup(tables.window, rows=task.observation.forecast_steps + 1),),
    "full_state": lambda task, tables: _plain("states", *(1.0,) * len(task.model_value.state_names)),
    # The published code counts the step just taken, hence the step whose weather is shown and not the number of steps.
    "step_counter": lambda task, tables: (Numbers("counter", (1,), (1.0,)),),
    "switches": lambda task, tables: tuple(Locked(name) for name, _ in task.observation_context().holds),
    "schedule": lambda task, tables: _plain("schedule", *(1.0,) * len(task.scheduled_places)),
    "prices": lambda task, tables: (Lookup(tables.prices, clocked=True),),
    "day_ahead_prices": lambda task, tables: (Lookup(tables.day_ahead, clocked=True),),
    "control_fractions": lambda task, tables: _plain("controls", *(1.0,) * len(task.model_value.control_names)),
    "published_time": lambda task, tables: (Lookup(np.ascontiguousarray(tables.clock[:, [2, 3, 0, 1]]), clocked=True),),
    "published_forecast": lambda task, tables: _ahead(task, tables.published),
}
