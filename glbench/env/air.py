"""Air temperature, CO2 and relative humidity inside, and sensors of them that err; violations are judged by the true values.

The reading of a quantity q in step k of a run of N steps is

    r(k) = q(k) + s w(k) + b + d k / N

with noise s w(k), w approximately normal and new in every step; a bias b of the run, approximately normal with the stated standard
deviation; and a drift that reaches d at the end, drawn evenly between minus and plus the stated value. Readings stay within their bounds.

A sensor that drops out shows its last reading until it is back. It does so with the chance 1 / (mean steps between) in each step but the
first of a run, and comes back with the chance 1 / (mean steps of a drop-out). docs/uncertainty.md has pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import casadi
import numpy as np

from glbench.arrays import Floats
from glbench.env.memory_layout import MemoryLayout
from glbench.env.random import UNIFORMS_PER_NORMAL, approx_normal
from glbench.errors import TaskError, refuse
from glbench.kernel.tape import Recorder, Tape, with_simplification
from glbench.model import co2_ppm, relative_humidity
from glbench.quantities import AIR as _AIR
from glbench.tasks import TaskSpec

AIR = {name: entry.unit for name, entry in _AIR.items()}
"""Quantities of the air inside, with units."""

PART = "sensors"
"""The sensors' part of a run's memory."""


def read_air(temperature: Floats, co2_density: Floats, vapour_pressure: Floats) -> Floats:
    """Air temperature [degC], CO2 [ppm], relative humidity [%, 0 to 100], ``(3, n)``, from degC, mg m-3 and Pa, each ``(n,)``."""
    values = (temperature, co2_density, vapour_pressure)
    outputs = _tape().play(lambda source, index: values[index])
    return np.stack([temperature, *(values for _, _, values in outputs)])


def air_quantities(temperature: Any, co2_density: Any, vapour_pressure: Any) -> tuple[Any, Any, Any]:
    """The same of one parcel, as expressions of a recorded formula."""

    def co2_and_humidity(temperature: Any, density: Any, pressure: Any) -> tuple[Any, Any]:
        # The benchmark caps relative humidity: air can be supersaturated for a moment, a hygrometer shows 100 %, also for NaN.
        humidity = relative_humidity(temperature, pressure)
        return co2_ppm(temperature, density), casadi.fmax(casadi.if_else(humidity < 100.0, humidity, 100.0), 0.0)

    return (temperature, *with_simplification(co2_and_humidity, temperature, co2_density, vapour_pressure))


@lru_cache(maxsize=1)
def _tape() -> Tape:
    with Recorder() as recorder:
        values = air_quantities(*(recorder.input("after", index) for index in range(3)))
        for index, value in enumerate(values[1:]):
            recorder.output("table", index, value)
    return recorder.tape()


@dataclass(frozen=True)
class Sensor:
    """One of the air's quantities: its place in ``AIR``, how far its sensor is off, and what it can show, all in its unit."""

    name: str
    place: int
    noise: float
    bias: float
    drift: float
    low: float
    high: float


@dataclass(frozen=True)
class Sensors:
    """The sensors of a task."""

    sensors: tuple[Sensor, ...]
    """Those that err."""
    out: float
    stays_out: float
    """``out`` and ``stays_out``: chance in a step to drop out, and to stay out; 0 where none does."""
    steps: int
    """Of an episode."""

    STREAM: ClassVar[str] = "sensors"
    TRAIT_STREAM: ClassVar[str] = "sensor offsets"

    @staticmethod
    def of(task: TaskSpec) -> Sensors:
        """A task's sensors, or nothing. Raises ``TaskError`` when the model has no air, or never shows one of the quantities."""
        table = task.sensors
        if table is None:
            return Sensors((), 0.0, 0.0, task.steps)
        if not task.model_value.air:
            refuse(f"{task.source}: [sensors] {task.model_id} has no air that a sensor could measure. Leave the table out.", TaskError)
        model, horizon = task.model_value, task.observation_context().horizon
        columns = [column for module in model.observation_modules for column in model.observed(module, horizon) or ()]
        bounds = {  # of the columns in which the model can show each quantity of its air
            column.source: (column.low / column.factor, column.high / column.factor) for column in columns if column.source in AIR
        }
        for name in dict(table.items()):
            if name not in bounds:
                refuse(f"{task.source}: [sensors.{name}] {task.model_id} never shows '{name}'. Leave the table out.", TaskError)
        sensors = tuple(
            Sensor(name, list(AIR).index(name), entry.noise, entry.bias, entry.drift, *bounds[name]) for name, entry in table.items()
        )
        out = stays = 0.0
        if table.dropouts is not None:
            out, stays = table.dropouts.chances(task.step_seconds)
        return Sensors(sensors, out, stays, task.steps)

    @property
    def _each(self) -> int:
        return UNIFORMS_PER_NORMAL + (self.out > 0.0)

    @property
    def numbers(self) -> int:
        """Random numbers needed in a step."""
        return self._each * len(self.sensors)

    @property
    def trait_numbers(self) -> int:
        """Random numbers needed once a run."""
        return (UNIFORMS_PER_NORMAL + 1) * len(self.sensors)

    @property
    def trait_count(self) -> int:
        """Bias and drift of each sensor."""
        return 2 * len(self.sensors)

    def traits(self, numbers: Floats) -> Floats:
        """Bias and drift of each sensor, ``(n, 2 sensors)``, from ``trait_numbers`` uniform numbers a run."""
        columns = numbers.reshape(len(numbers), len(self.sensors), UNIFORMS_PER_NORMAL + 1)
        traits = [
            column
            for place, sensor in enumerate(self.sensors)
            for column in (
                approx_normal(*columns[:, place, :UNIFORMS_PER_NORMAL].T) * sensor.bias,
                (2.0 * columns[:, place, UNIFORMS_PER_NORMAL] - 1.0) * sensor.drift,
            )
        ]
        return np.stack(traits, axis=1) if traits else np.zeros((len(numbers), 0))

    def initial_memory(self) -> dict[str, float]:
        """Numbers kept from step to step, with start values: whether each sensor has dropped out, and its last reading."""
        if self.out == 0.0:
            return {}
        return {f"{what} {sensor.name}": 0.0 for sensor in self.sensors for what in ("out", "held")}

    def readings(self, recorder: Recorder, air: Sequence[Any], layout: MemoryLayout) -> list[Any]:
        """What the sensors show of ``air`` (its quantities in order, true): recorded values, those without a sensor as they are."""
        readings = list(air)
        memory = layout.of(PART)
        for place, sensor in enumerate(self.sensors):
            reading = self._reading(recorder, sensor, place, air[sensor.place])
            if memory:
                out, last = (recorder.input("memory", memory[f"{what} {sensor.name}"]) for what in ("out", "held"))
                reading = out * last + (1.0 - out) * reading
            readings[sensor.place] = reading
        return readings

    def update(self, recorder: Recorder, air: Sequence[Any], layout: MemoryLayout) -> None:
        """Record which sensors have dropped out after a step, and their last reading."""
        memory = layout.of(PART)
        steps: Any = recorder.input("counter", 0) if memory else 0.0
        not_first = np.minimum(steps - 1.0, 1.0)
        for place, sensor in enumerate(self.sensors if memory else ()):
            out_place, last_place = (memory[f"{what} {sensor.name}"] for what in ("out", "held"))
            was_out, last = recorder.input("memory", out_place), recorder.input("memory", last_place)
            number = recorder.input("noise", place * self._each + UNIFORMS_PER_NORMAL)
            # Before the first step there is no last reading.
            chance = (was_out * (self.stays_out - self.out) + self.out) * not_first
            out = np.maximum(np.sign(chance - number), 0.0)
            reading = self._reading(recorder, sensor, place, air[sensor.place])
            recorder.output("memory", out_place, out)
            # A sensor that has dropped out keeps its last reading, also that of the step before it dropped out.
            recorder.output("memory", last_place, out * last + (1.0 - out) * reading)

    def _reading(self, recorder: Recorder, sensor: Sensor, place: int, true: Any) -> Any:
        first = place * self._each
        noise = approx_normal(*(recorder.input("noise", first + number) for number in range(UNIFORMS_PER_NORMAL)))
        bias, drift = (recorder.input("trait", 2 * place + which) for which in range(2))
        reading = true + noise * sensor.noise + bias + drift * (recorder.input("counter", 0) * (1.0 / self.steps))
        return np.minimum(np.maximum(reading, sensor.low), sensor.high)
