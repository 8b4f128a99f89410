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
from typing import TYPE_CHECKING

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


def _indoor_climate(order: tuple[int, int, int]) -> MakeObservation:
    def make(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
        def part(situation: Situation) -> NDArray[np.float64]:
            columns = np.empty((len(situation.states), 4))
            for column, quantity in enumerate(order):
                columns[:, column] = situation.air[quantity]
            columns[:, 3] = situation.states[:, _PIPE]
            return columns

        return part

    return make


def _crop(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    shown = np.array([_FRUIT, _MEAN_CANOPY, _CANOPY_SUM])

    def part(situation: Situation) -> NDArray[np.float64]:
        columns = situation.states.take(shown, axis=1)
        columns[:, 0] *= KG_PER_MG
        return columns

    return part


def _published_crop(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    return lambda situation: situation.states[:, [_MEAN_CANOPY, _FRUIT, _CANOPY_SUM]]


def _controls(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    by_name = {capacity.name: capacity.at_one for capacity in task.capacities()}
    at_one = np.array([by_name[name] for name in CONTROL_NAMES])
    return lambda situation: situation.controls * at_one


def _weather(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    return lambda situation: tables.measured.take(situation.weather_rows, axis=0)


def _time(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    return lambda situation: tables.clock.take(situation.steps, axis=0)


def _published_time(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    clock = np.ascontiguousarray(tables.clock[:, [2, 3, 0, 1]])
    return lambda situation: clock[situation.steps]


def _forecast_of(table: NDArray[np.float32], rows_ahead: int) -> ObservationPart:
    width = table.shape[1]
    windows = np.lib.stride_tricks.sliding_window_view(table.reshape(-1), rows_ahead * width)[::width]
    return lambda situation: windows[situation.weather_rows + 1]


def _forecast(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    return _forecast_of(tables.measured, task.observation.forecast_steps)


def _published_forecast(task: TaskSpec, tables: WeatherTables) -> ObservationPart:
    return _forecast_of(tables.published, task.observation.forecast_steps)


_MAKERS.update(
    {
        "indoor_climate": _indoor_climate((0, 1, 2)),
        "crop": _crop,
        "time": _time,
        "controls": _controls,
        "weather": _weather,
        "forecast": _forecast,
        "full_state": lambda task, tables: lambda situation: situation.states,
        # The published code counts the step just taken, hence the weather row and not the number of steps.
        "step_counter": lambda task, tables: lambda situation: situation.weather_rows[:, None].astype(np.float64),
        "control_fractions": lambda task, tables: lambda situation: situation.controls,
        "published_indoor_climate": _indoor_climate((1, 0, 2)),
        "published_crop": _published_crop,
        "published_time": _published_time,
        "published_forecast": _published_forecast,
    }
)
