"""Observations: small named parts, put side by side in the order of the task.

Names, units and bounds of the columns belong to the task (``glbench.tasks.vocabulary``); their values are computed here. A
part is made once for a task and called after every step. To add one, register its columns and a function that makes it:

    def canopy(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
        return lambda situation: situation.states[:, 4:5]

    register_observation(ObservationModule("canopy", "canopy temperature", columns), canopy)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from glbench.env.weather_tables import WeatherTables
from glbench.errors import TaskError, UnknownNameError, did_you_mean
from glbench.model import CONTROL_NAMES, STATE_NAMES
from glbench.tasks.vocabulary import OBSERVATION_MODULES, ObservationModule

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

KG_PER_MG = 1e-6
_PIPE, _FRUIT, _MEAN_CANOPY, _CANOPY_SUM = (STATE_NAMES.index(n) for n in ("tPipe", "cFruit", "tCan24", "tCanSum"))


@dataclass(frozen=True, eq=False)
class Situation:
    """What an observation may look at, for ``n`` rows.

    ``states`` ``(n, 28)`` and ``controls`` (fractions, ``(n, 6)``) are those after the step; ``air`` holds air temperature
    [degC], CO2 [ppm] and relative humidity [%], ``(3, n)``. ``steps`` counts the steps taken; the clock follows it.
    ``weather_rows`` is the weather row to show, by the task's timing: the one that acts next ("current") or the one that
    has just acted ("published").
    """

    states: NDArray[np.float64]
    controls: NDArray[np.float64]
    air: NDArray[np.float64]
    steps: NDArray[np.int64]
    weather_rows: NDArray[np.int64]


Source = Literal["states", "air", "controls", "counter"]


@dataclass(frozen=True)
class Numbers:
    """Columns that are numbers of the situation times factors; "counter" has the steps taken and the number of the weather row shown."""

    source: Source
    indices: tuple[int, ...]
    factors: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class TableRows:
    """Columns that are ``rows`` whole rows of a float32 table ``(rows, width)``, side by side.

    The first is ``ahead`` rows after that of the clock (``clocked``) or of the weather shown.
    """

    table: NDArray[np.float32]
    rows: int = 1
    clocked: bool = False
    ahead: int = 0


Shown = Numbers | TableRows

ObservationPart = Callable[[Situation], NDArray[np.floating]]
"""Columns of one module, ``(n, columns)``. Row i may depend on row i of the situation only."""

MakeObservation = Callable[["TaskSpec", WeatherTables], ObservationPart]

_MAKERS: dict[str, MakeObservation] = {}


def register_observation(module: ObservationModule, make: MakeObservation) -> None:
    """Make an observation module known, here and in task files.

    Raises
    ------
    TaskError
        When its name is taken.
    """
    OBSERVATION_MODULES.add(module)
    _MAKERS[module.name] = make


class Observer:
    """The observation of a task: its modules side by side, as float32."""

    def __init__(self, task: TaskSpec) -> None:
        context = task.observation_context()
        tables = WeatherTables.of(task)
        self.columns = len(task.observed())
        self._published = task.observation.timing == "published"
        self._parts: list[tuple[slice, ObservationPart]] = []
        start = 0
        for name in task.observation.modules:
            if name not in _MAKERS:
                msg = f"There is no observation module called '{name}'.{did_you_mean(name, _MAKERS)}"
                raise UnknownNameError(msg)
            stop = start + len(OBSERVATION_MODULES[name].quantities(context))
            self._parts.append((slice(start, stop), _MAKERS[name](task, tables)))
            start = stop
        if start != self.columns:
            msg = f"{task.id} announces {self.columns} observed columns, its modules have {start}."
            raise TaskError(msg)

    def __call__(
        self,
        states: NDArray[np.float64],
        controls: NDArray[np.float64],
        air: NDArray[np.float64],
        steps: NDArray[np.int64],
    ) -> NDArray[np.float32]:
        """Observations ``(n, columns)`` of the situation after ``steps`` steps."""
        rows = np.maximum(steps - 1, 0) if self._published else steps
        situation = Situation(states, controls, air, steps, rows)
        observation = np.empty((len(states), self.columns), dtype=np.float32)
        for columns, part in self._parts:
            observation[:, columns] = part(situation)
        return observation


def shown_by(name: str, task: TaskSpec, tables: WeatherTables) -> tuple[Shown, ...] | None:
    """The columns of a shipped module as data; ``None`` for one that somebody registered."""
    return _SHOWN[name](task, tables) if name in _SHOWN and _MAKERS.get(name) is _SHIPPED[name] else None


def _numbers(source: Source, *indices: int) -> tuple[Shown, ...]:
    return (Numbers(source, indices, (1.0,) * len(indices)),)


def _crop(task: TaskSpec, tables: WeatherTables) -> tuple[Shown, ...]:
    return (Numbers("states", (_FRUIT, _MEAN_CANOPY, _CANOPY_SUM), (KG_PER_MG, 1.0, 1.0)),)


def _controls(task: TaskSpec, tables: WeatherTables) -> tuple[Shown, ...]:
    by_name = {capacity.name: capacity.at_one for capacity in task.capacities()}
    return (Numbers("controls", tuple(range(len(CONTROL_NAMES))), tuple(by_name[name] for name in CONTROL_NAMES)),)


def _ahead(task: TaskSpec, table: NDArray[np.float32]) -> tuple[Shown, ...]:
    return (TableRows(table, rows=task.observation.forecast_steps, ahead=1),)


_SHOWN: dict[str, Callable[[TaskSpec, WeatherTables], tuple[Shown, ...]]] = {
    "indoor_climate": lambda task, tables: _numbers("air", 0, 1, 2) + _numbers("states", _PIPE),
    "crop": _crop,
    "time": lambda task, tables: (TableRows(tables.clock, clocked=True),),
    "controls": _controls,
    "weather": lambda task, tables: (TableRows(tables.measured),),
    "forecast": lambda task, tables: _ahead(task, tables.measured),
    "full_state": lambda task, tables: _numbers("states", *range(len(STATE_NAMES))),
    # The published code counts the step just taken, hence the weather row and not the number of steps.
    "step_counter": lambda task, tables: _numbers("counter", 1),
    "control_fractions": lambda task, tables: _numbers("controls", *range(len(CONTROL_NAMES))),
    "published_indoor_climate": lambda task, tables: _numbers("air", 1, 0, 2) + _numbers("states", _PIPE),
    "published_crop": lambda task, tables: _numbers("states", _MEAN_CANOPY, _FRUIT, _CANOPY_SUM),
    "published_time": lambda task, tables: (
        TableRows(np.ascontiguousarray(tables.clock[:, [2, 3, 0, 1]]), clocked=True),
    ),
    "published_forecast": lambda task, tables: _ahead(task, tables.published),
}


def _maker(name: str) -> MakeObservation:
    """Makes the part that shows, with numpy, what ``_SHOWN`` says."""

    def make(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
        parts = [_part(shown) for shown in _SHOWN[name](task, tables)]
        return parts[0] if len(parts) == 1 else lambda situation: np.hstack([part(situation) for part in parts])

    return make


def _part(shown: Shown) -> ObservationPart:
    if isinstance(shown, Numbers):
        indices, factors = list(shown.indices), np.array(shown.factors)
        if shown.source == "air":
            return lambda situation: situation.air[indices].T * factors
        if shown.source == "states":
            return lambda situation: situation.states.take(indices, axis=1) * factors
        if shown.source == "controls":
            return lambda situation: situation.controls.take(indices, axis=1) * factors
        counters = [("steps", "weather_rows")[index] for index in indices]
        return lambda situation: np.stack([getattr(situation, name) for name in counters], axis=1) * factors
    table, rows, ahead, width = shown.table, shown.rows, shown.ahead, shown.table.shape[1]
    if rows > 1:
        table = np.lib.stride_tricks.sliding_window_view(table.reshape(-1), rows * width)[::width]
    if shown.clocked:
        return lambda situation: table[situation.steps + ahead]
    return lambda situation: table[situation.weather_rows + ahead]


_SHIPPED: dict[str, MakeObservation] = {name: _maker(name) for name in _SHOWN}
_MAKERS.update(_SHIPPED)
