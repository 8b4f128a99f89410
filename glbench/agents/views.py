"""Views: what an agent looks at of all that a task shows it, so that agents of one recipe can differ in nothing else.

A view is a list of names. Each adds the columns of a view (``VIEWS``), of an observation module, or one column; with ``-`` before it, it
takes them away: ``[sensors, -co2]``. What other tasks have and this one lacks adds nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.errors import UnknownNameError, did_you_mean, refuse
from glbench.tasks.vocabulary import OBSERVATION_MODULES

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

_FORECASTS = ("weather_forecast", "forecast", "published_forecast")
_POSITIONS = ("controls", "control_fractions", "switches")
OUTDOOR = ("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "wind_speed")
"""Columns that a blind agent keeps running means of."""
VIEWS: Mapping[str, tuple[str, ...]] = {
    "clock": ("time", "local_time", "published_time", "step_counter", "planting", "prices", "day_ahead_prices"),
    "outdoor": ("clock", "weather", "weather_window", "schedule", *_POSITIONS, *_FORECASTS),
    "blind": ("outdoor",),
    "two_sensors": ("outdoor", *_POSITIONS, "air_temperature", "relative_humidity", "vapour_deficit"),
    "sensors": (
        "two_sensors", "indoor_climate", "published_indoor_climate", "light_today", "crop", "published_crop", "registration", "crop_health",
        "camera", "energy",
    ),
    "memory": ("sensors",),
    "no_forecast": ("sensors", *(f"-{name}" for name in _FORECASTS)),
}  # fmt: skip
"""Named views, each of names; ``without_X`` is ``sensors`` without the column or module X and what follows from it."""
RECALLING = ("blind", "memory")
"""Views of agents that also remember."""
_WITHOUT = "without_"
_FOLLOWS = {"air_temperature": ("-vapour_deficit",), "relative_humidity": ("-vapour_deficit",), "prices": ("-day_ahead_prices",)}
_OPTIONAL = {name.removeprefix("-") for names in VIEWS.values() for name in names}


def visible_columns(task: TaskSpec, view: Sequence[str]) -> NDArray[np.bool_]:
    """Columns ``(n,)`` of a task that a view has. Raises ``UnknownNameError`` when a name is unknown, or the view has none of them."""
    columns = _columns(task, view)
    mask = np.array([column.name in columns for column in task.observed()], np.bool_)
    if not mask.any():
        refuse(f"The view {', '.join(view) or '[]'} has no column that {task.id} shows.", UnknownNameError)
    return mask


def left_out_views(task: TaskSpec) -> list[str]:
    """Views without the forecast, prices, or one sensor: a column of the climate inside, or what is measured of crop, buffer or weather."""
    modules = task.observation.modules
    sensors = [
        column.name for module in modules if module in ("indoor_climate", "published_indoor_climate") for column in task.observed_by(module)
    ]
    parts = [
        *sensors,
        *(module for module in ("crop", "published_crop", "registration", "camera", "energy", "weather", "prices") if module in modules),
    ]
    forecast = ["no_forecast"] if {*modules} & {*_FORECASTS} else []
    return [*forecast, *(f"{_WITHOUT}{part}" for part in parts)]


def _columns(task: TaskSpec, names: Sequence[str]) -> set[str]:
    """Columns of a view of these names."""
    columns: set[str] = set()
    for name in names:
        part = _columns_of(task, name.removeprefix("-"))
        columns = columns - part if name.startswith("-") else columns | part
    return columns


def _columns_of(task: TaskSpec, name: str) -> set[str]:
    if name.startswith(_WITHOUT):
        lacking = name.removeprefix(_WITHOUT)
        return _columns(task, ("sensors", f"-{lacking}", *_FOLLOWS.get(lacking, ())))
    if name in VIEWS:
        reveals = name == "outdoor" and task.actuation.kind == "process_computer"  # which moves controls by what it measures inside
        return _columns(task, [part for part in VIEWS[name] if not (reveals and part in _POSITIONS)])
    if name in task.observation.modules:
        return {column.name for column in task.observed_by(name)}
    observed = [column.name for column in task.observed()]
    if name not in (*observed, *_OPTIONAL, *OBSERVATION_MODULES.names):
        choices = (*VIEWS, *task.observation.modules, *observed)
        refuse(f"{task.id} has no view, observation module or column '{name}'.{did_you_mean(name, choices)}", UnknownNameError)
    return {name} & {*observed}
