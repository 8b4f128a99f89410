"""What follows from a task's definition: parameters, weather, start, observed columns. Each is worked out once a process.

Errors of the model and the weather are handed on with the task's file and the table that asked for the impossible.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from glbench.errors import GlbenchError, ParameterError, TaskError, UnknownNameError, did_you_mean
from glbench.tasks.quantities import Quantity
from glbench.tasks.vocabulary import INITIAL_STATES, OBSERVATION_MODULES

if TYPE_CHECKING:
    from glbench.tasks.spec import TaskSpec
    from glbench.tasks.tables import Override, WeatherTable
    from glbench.weather import Disturbances, WeatherRecord

FloatArray = npt.NDArray[np.float64]


@contextmanager
def asked_for_by(task: TaskSpec, table: str) -> Iterator[None]:
    """Name the task's file and ``table`` in whatever goes wrong inside."""
    try:
        yield
    except TaskError:
        raise
    except GlbenchError as error:
        msg = f"{task.source}: [{table}] {error}"
        raise TaskError(msg) from error


def resolved_parameters(task: TaskSpec) -> FloatArray:
    """See ``TaskSpec.parameters``."""
    with asked_for_by(task, "model"):
        return _parameters(task.model.parameters, task.model.overrides)


@lru_cache(maxsize=64)
def _parameters(name: str, overrides: tuple[Override, ...]) -> FloatArray:
    from glbench.model import default_parameters

    return _read_only(default_parameters(name, {given: (value, unit) for given, value, unit in overrides}))


def resolved_uncertain_parameters(task: TaskSpec) -> tuple[str, ...]:
    """See ``TaskSpec.uncertain_parameters``."""
    from glbench.model import PARAMETER_NAMES, PARAMETERS, crop_parameter_set

    wanted = task.uncertainty.parameters
    with asked_for_by(task, "uncertainty"):
        if isinstance(wanted, str):
            return crop_parameter_set(wanted)
        for name in wanted:
            if name not in PARAMETER_NAMES:
                msg = f"There is no parameter called '{name}'.{did_you_mean(name, PARAMETER_NAMES)}"
                raise UnknownNameError(msg)
            info = PARAMETERS[PARAMETER_NAMES.index(name)]
            if info.is_derived:
                msg = f"'{name}' follows from other parameters ({name} = {info.formula}): list those instead."
                raise ParameterError(msg)
    return wanted


def resolved_record(task: TaskSpec) -> WeatherRecord:
    """See ``TaskSpec.record``."""
    with asked_for_by(task, "weather"):
        return _record(task.weather.source)


@lru_cache(maxsize=4)
def _record(source: str) -> WeatherRecord:
    from glbench.weather import load_weather

    return load_weather(source)


def resolved_disturbances(task: TaskSpec, rows: int) -> Disturbances:
    """See ``TaskSpec.disturbances``."""
    with asked_for_by(task, "weather"):
        return _disturbances(task.weather, rows)


@lru_cache(maxsize=8)
def _disturbances(table: WeatherTable, rows: int) -> Disturbances:
    from glbench.weather import disturbances

    return disturbances(
        _record(table.source),
        start=table.start,
        steps=rows,
        step_seconds=float(table.step_seconds),
        preprocessing=table.preprocessing,
        co2_ppm=table.co2_ppm,
    )


def resolved_initial_state(task: TaskSpec) -> FloatArray:
    """See ``TaskSpec.initial_state``."""
    first = task.disturbances().values[0]
    with asked_for_by(task, "initial_state"):
        start = INITIAL_STATES[task.initial.kind]
        return _read_only(start.state(first, task.initial.air_temperature, resolved_parameters(task)))


def resolved_observation(task: TaskSpec) -> tuple[Quantity, ...]:
    """See ``TaskSpec.observed``."""
    context = task.observation_context()
    columns: dict[str, Quantity] = {}
    for module in task.observation.modules:
        for quantity in OBSERVATION_MODULES[module].quantities(context):
            if quantity.name in columns:
                msg = (
                    f"{task.source}: [observation] '{quantity.name}' of '{module}' is shown by another module already."
                )
                raise TaskError(msg)
            columns[quantity.name] = quantity
    return tuple(columns.values())


def _read_only(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
