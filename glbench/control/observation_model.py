"""The observation model of a task: what it shows of states and controls, as functions that a filter can use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.accounts import ByName
from glbench.env.air import AIR, Sensors, air_quantities
from glbench.errors import TaskError, refuse
from glbench.kernel.tape import Recorder, TapeDerivatives
from glbench.tasks import TaskSpec
from glbench.tasks.tables import SampleTable


class ObservationModel:
    """The observed columns of a task that are functions of its model's states, with their gradients.

    Those of the model's modules, and ``full_state``. Left out are those computed from the observed air, which add no information, and sums
    since midnight, which are not functions of the states.

    ``columns`` are their indices in the observation, ``names`` their names, and ``control_columns`` the indices of the controls in force;
    ``None`` if the task does not show them. For each column, ``sensor`` is the index of its sensor among the task's sensors with errors, -1
    if it is observed without errors, and ``samples`` how it is sampled by hand, ``None`` if it is observed in every step.
    """

    def __init__(self, task: TaskSpec) -> None:
        model = task.model_value
        self._states = len(model.states)
        nominal = model.Parameters(*task.parameters().tolist())
        erring = [sensor.name for sensor in Sensors.of(task).sensors]
        columns: list[int] = []
        names: list[str] = []
        sensors: list[int] = []
        samples: list[SampleTable | None] = []
        first = 0
        with Recorder() as recorder:
            states = [recorder.input("after", place) for place in range(self._states)]
            by_name = ByName(model.states, states)
            air: dict[str, Any] = {}
            if model.air:
                parcel = model.air_of(*(states[model.state_index(name)] for name in model.air))
                air = dict(zip(AIR, air_quantities(*parcel), strict=True))
            for module in task.observation.modules:
                observed = task.observed_by(module)
                of_model = model.observed(module, task.observation_context().horizon)
                sources: list[tuple[Any, int]] = [(None, -1)] * len(observed)
                if of_model is None and module == "full_state":
                    sources = [(state, -1) for state in states]
                for place, column in enumerate(of_model or ()):
                    if column.of is not None:
                        sources[place] = column.of(by_name, nominal), -1
                    elif column.source in air:
                        sensor = erring.index(column.source) if column.source in erring else -1
                        sources[place] = air[column.source] * column.factor, sensor
                    elif column.source in model.state_names:
                        sources[place] = states[model.state_index(column.source)] * column.factor, -1
                for place, (value, sensor) in enumerate(sources):
                    if value is not None:
                        recorder.output("observation", len(columns), value)
                        columns.append(first + place)
                        names.append(observed[place].name)
                        sensors.append(sensor)
                        samples.append(task.samples.get(module))
                first += len(observed)
        self.columns, self.names = np.array(columns, np.intp), tuple(names)
        self.sensor, self.samples = np.array(sensors, np.intp), tuple(samples)
        self._derivatives = TapeDerivatives(recorder.tape(), [("observation", place) for place in range(len(columns))], ("after",))

        observed_names, capacities = [column.name for column in task.observed()], task.capacities()
        self.control_columns: NDArray[np.intp] | None = None
        self._control_at_one = np.ones(len(capacities))
        for ending, at_one in (("_fraction", [1.0] * len(capacities)), ("", [one.at_one for one in capacities])):
            controls = [f"{one.quantity}{ending}" for one in capacities]
            if all(name in observed_names for name in controls):
                self.control_columns = np.array([observed_names.index(name) for name in controls], np.intp)
                self._control_at_one = np.where(np.array(at_one) > 0.0, at_one, 1.0)

    def controls(self, observations: Floats) -> Floats:
        """Controls in force ``(n, c)``, fractions, of a task that shows them."""
        assert self.control_columns is not None
        return np.clip(observations[:, self.control_columns] / self._control_at_one, 0.0, 1.0)

    def of(self, states: Floats) -> tuple[Floats, Floats]:
        """Values ``(n, columns)`` in ``states`` ``(n, s)``, and their gradients ``(n, columns, s)``."""
        values = np.empty((len(states), len(self.columns)))
        slopes = np.zeros((*values.shape, self._states))
        for place, column in enumerate(self._derivatives(lambda source, index: states[:, index], {"after": slopes})):
            values[:, place] = column
        return values, slopes


def checked_observations(task: TaskSpec, observations: Any, n: int, names: Sequence[str]) -> Floats:
    """Own copy ``(n, columns)``, float32, of the columns; NaN is missing. Raises ``TaskError`` for a wrong shape or an infinite reading."""
    values = np.array(observations, dtype=np.float64)
    expected = (n, len(names))
    if values.shape != expected:
        refuse(f"Wrong shape of the observations of {task.id}: expected {expected}, a row for each run; got {values.shape}.", TaskError)
    _refuse(np.isinf(values), task, names, "is infinite. If it is missing, pass NaN.")
    return values


def refuse_missing(observations: Floats, columns: Sequence[int] | NDArray[np.intp], task: TaskSpec, names: Sequence[str], why: str) -> None:
    """Refuse observations that lack a reading (NaN) of these columns, and say ``why``. Raises ``TaskError`` when one is missing."""
    _refuse(np.isnan(observations[:, columns]), task, [names[column] for column in columns], f"is missing (NaN). {why}")


def _refuse(wrong: NDArray[np.bool_], task: TaskSpec, names: Sequence[str], what: str) -> None:
    for run, column in np.argwhere(wrong).tolist():
        refuse(f"The reading of '{names[column]}' in row {run} of the observations of {task.id} {what}", TaskError)
