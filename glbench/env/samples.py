"""Columns of the crop that people count or weigh by hand: seen once in some days, with errors, and held in between.

The sample of a quantity q in step k, where k = 0, N, 2 N, ... with N steps between samples, is

    r(k) = q(k) (1 + s w(k))

with a relative standard deviation s and w approximately normal, new for each sample and column. It stays within the bounds of the
column. The observation shows the last sample. docs/uncertainty.md tells more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from glbench.arrays import Floats
from glbench.env.accounts import ByName
from glbench.env.memory_layout import DrawPlaces, MemoryLayout
from glbench.env.process_computer import at_least, below, select, within
from glbench.env.random import UNIFORMS_PER_NORMAL, approx_normal
from glbench.errors import TaskError, refuse
from glbench.kernel.tape import Recorder
from glbench.model import ObservedColumn
from glbench.tasks import TaskSpec
from glbench.tasks.tables import SampleTable

PART = "samples"
"""The samples' part of a run's memory."""


@dataclass(frozen=True)
class SampledColumn:
    """A column that is sampled: its module, that module's table, and its value as a function of the states."""

    module: str
    table: SampleTable
    column: ObservedColumn
    of: Callable[[Sequence[Any]], Any]

    def sample(self, states: Sequence[Any], w: Any) -> Any:
        """A sample in ``states``, with an approximately normal number."""
        return within(self.of(states) * (1.0 + self.table.noise * w), self.column.low, self.column.high)


@dataclass(frozen=True)
class Samples:
    """The columns of a task that are sampled, the steps of a day, the number of states, and where what they draw begins.

    The number of the first sample is a trait of the run: the tape that keeps samples runs after a step and has that step's numbers.
    """

    columns: tuple[SampledColumn, ...]
    day: int
    states: int
    places: DrawPlaces

    STREAM: ClassVar[str] = "samples"
    TRAIT_STREAM: ClassVar[str] = "first samples"

    @staticmethod
    def of(task: TaskSpec, places: DrawPlaces) -> Samples:
        """The samples of a task, if any. Raises ``TaskError`` when a module is not the model's own, or has other columns than states."""
        model, columns = task.model_value, []
        for module, table in task.samples.items():
            observed = model.observed(module, task.observation_context().horizon)
            if observed is None:
                can = ", ".join(f"'{name}'" for name in model.observation_modules)
                refuse(f"{task.source}: [samples.{module}] only modules of {model.id} can be sampled: {can}.", TaskError)
            columns += [SampledColumn(module, table, column, _of_states(task, module, column)) for column in observed]
        return Samples(tuple(columns), task.steps_per_day, len(model.states), places)

    @property
    def numbers(self) -> int:
        """Random numbers needed in a step, and as many once a run."""
        return UNIFORMS_PER_NORMAL * len(self.columns)

    trait_numbers = numbers

    @property
    def trait_count(self) -> int:
        """The number w of the first sample of each column."""
        return len(self.columns)

    def traits(self, numbers: Floats) -> Floats:
        """The number w of the first sample of each column, ``(n, columns)``, from ``trait_numbers`` uniform numbers a run."""
        traits: Floats = approx_normal(*numbers.reshape(len(numbers), len(self.columns), UNIFORMS_PER_NORMAL).transpose(2, 0, 1))
        return traits

    def initial_memory(self) -> dict[str, float]:
        """Numbers kept from step to step: of each module the steps since its last sample, 0 while there is none, and its columns.

        An episode may begin in the midst of a season (``glbench.jax``): the first sample is taken where it begins.
        """
        return {f"since {one.module}": 0.0 for one in self.columns} | {one.column.name: 0.0 for one in self.columns}

    def readings(self, recorder: Recorder, module: str, layout: MemoryLayout) -> list[Any]:
        """What the observation shows of the columns of ``module``, recorded: the first sample at the start, then the one in memory."""
        memory, states = layout.of(PART), [recorder.input("after", place) for place in range(self.states)]
        started = at_least(recorder.input("memory", memory[f"since {module}"]), 1.0)
        return [
            select(started, recorder.input("memory", memory[one.column.name]), one.sample(states, self._first(recorder, place)))
            for place, one in enumerate(self.columns)
            if one.module == module
        ]

    def update(self, recorder: Recorder, layout: MemoryLayout) -> None:
        """Record the samples in memory after a step: at first that of the start, then a new one where one is due."""
        if not self.columns:
            return
        memory, due = layout.of(PART), {}
        first = below(recorder.input("memory", memory[f"since {self.columns[0].module}"]), 1.0)
        states = [select(first, recorder.input("before", place), recorder.input("after", place)) for place in range(self.states)]
        for module, every in {one.module: float(one.table.every_days * self.day) for one in self.columns}.items():
            place = memory[f"since {module}"]
            since = recorder.input("memory", place)
            now = since - every * at_least(since, every) + 1.0
            due[module] = at_least(now, every)
            recorder.output("memory", place, now)
        for number, one in enumerate(self.columns):
            place, start = memory[one.column.name], self.places.noise + UNIFORMS_PER_NORMAL * number
            w = approx_normal(*(recorder.input("noise", start + offset) for offset in range(UNIFORMS_PER_NORMAL)))
            sample = one.sample(states, select(first, self._first(recorder, number), w))
            recorder.output("memory", place, select(np.maximum(first, due[one.module]), sample, recorder.input("memory", place)))

    def _first(self, recorder: Recorder, place: int) -> Any:
        return recorder.input("trait", self.places.trait + place)


def _of_states(task: TaskSpec, module: str, column: ObservedColumn) -> Callable[[Sequence[Any]], Any]:
    """A column as a function of the states."""
    model, of = task.model_value, column.of
    nominal = model.Parameters(*task.parameters().tolist())
    if of is not None:
        return lambda states: of(ByName(model.states, states), nominal)
    if column.source not in model.state_names:
        why = f"'{column.name}' is measured by a sensor, or is a sum since midnight; only what depends on the crop's states can be sampled."
        refuse(f"{task.source}: [samples.{module}] {why}", TaskError)
    place = model.state_index(column.source)
    return lambda states: states[place] * column.factor
