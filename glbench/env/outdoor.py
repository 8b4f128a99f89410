"""Sensors of the weather that err: what agents and the process computer read; what acts on the greenhouse is the truth.

The reading of a quantity q in step k of a run is

    r(k) = a q(k) (1 + s w(k))      of global radiation and wind speed,
    r(k) = q(k) + b + s w(k)        of temperature and relative humidity,

with a scale a of the run, drawn evenly between its limits; a bias b of the run, approximately normal with the stated standard
deviation; and noise w(k), approximately normal and new in every step. The reading stays within the bounds of its column. A soiled
pyranometer shows too little, and an anemometer on a mast of another height the wind of that height: both by a factor, so that dark stays
dark. docs/uncertainty.md has pictures.

What is summed since midnight has a reading for each step, with the noise of its end. Forecasts do not come from these sensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from glbench.env.air import air_quantities
from glbench.env.memory_layout import DrawPlaces
from glbench.env.random import UNIFORMS_PER_NORMAL, approx_normal
from glbench.errors import TaskError
from glbench.kernel.tape import Recorder
from glbench.quantities import OUTDOOR
from glbench.tasks.tables import PROCESS_COMPUTER, ScaledSensorTable
from glbench.weather import COLUMNS

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

MEASURED = ("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "outdoor_co2", "wind_speed")
"""What is read outside, in the order of ``WeatherTables.measured``."""

_READERS = ("weather", "light_today")


@dataclass(frozen=True)
class OutdoorSensor:
    """A sensor of one of ``MEASURED``: limits of its scale if it is off by a factor, its noise, its bias, and what it can show."""

    name: str
    scale: tuple[float, float] | None
    noise: float
    bias: float
    low: float
    high: float

    def trait(self, numbers: Floats) -> Floats:
        """Scale or bias of runs ``(n,)`` from uniform numbers ``(n, 3)``."""
        if self.scale is None:
            return np.asarray(approx_normal(*numbers.T) * self.bias)
        low, high = self.scale
        return np.asarray(low + (high - low) * numbers[:, 0])

    def reading(self, true: Any, trait: Any, normal: Any) -> Any:
        """What it shows of ``true`` with a normal number of the step."""
        noise = normal * self.noise
        shown = true + trait + noise if self.scale is None else true * trait * (1.0 + noise)
        return np.minimum(np.maximum(shown, self.low), self.high)


@dataclass(frozen=True)
class OutdoorSensors:
    """The sensors of the weather that err, and where what they draw begins."""

    sensors: tuple[OutdoorSensor, ...]
    places: DrawPlaces

    STREAM: ClassVar[str] = "outdoor sensors"
    TRAIT_STREAM: ClassVar[str] = "outdoor sensor offsets"

    @staticmethod
    def of(task: TaskSpec, places: DrawPlaces) -> OutdoorSensors:
        """The sensors of a task; of a task without any, nothing.

        Raises
        ------
        TaskError
            When nobody reads them.
        """
        table = task.outdoor_sensors
        if table is None:
            return OutdoorSensors((), places)
        if task.actuation.kind != PROCESS_COMPUTER and not set(_READERS) & set(task.observation.modules):
            msg = (
                f"{task.source}: [outdoor_sensors] nobody reads them: no process computer, and neither '{_READERS[0]}' nor "
                f"'{_READERS[1]}' is among the modules. Leave the table out."
            )
            raise TaskError(msg)
        sensors = []
        for name, entry in table.items():
            of_column, scale, bias = OUTDOOR[name], None, 0.0
            if isinstance(entry, ScaledSensorTable):
                scale = entry.scale.low, entry.scale.high
            else:
                bias = entry.bias
            sensors.append(OutdoorSensor(name, scale, entry.noise, bias, of_column.low, of_column.high))
        return OutdoorSensors(tuple(sensors), places)

    @property
    def middles(self) -> Floats:
        """Middle of the scale of each of ``MEASURED`` ``(5,)``: what a reading is best divided by while nothing more is known."""
        scales = {sensor.name: sum(sensor.scale) / 2.0 for sensor in self.sensors if sensor.scale is not None}
        return np.array([scales.get(name, 1.0) for name in MEASURED])

    @property
    def numbers(self) -> int:
        """Random numbers needed in a step."""
        return UNIFORMS_PER_NORMAL * len(self.sensors)

    @property
    def trait_numbers(self) -> int:
        """Random numbers needed once a run."""
        return UNIFORMS_PER_NORMAL * len(self.sensors)

    @property
    def trait_count(self) -> int:
        """A scale or a bias of each sensor."""
        return len(self.sensors)

    def traits(self, numbers: Floats) -> Floats:
        """Scale or bias of each sensor, ``(n, sensors)``, from ``trait_numbers`` uniform numbers a run."""
        columns = numbers.reshape(len(numbers), len(self.sensors), UNIFORMS_PER_NORMAL)
        traits = np.zeros((len(numbers), len(self.sensors)))
        for place, sensor in enumerate(self.sensors):
            traits[:, place] = sensor.trait(columns[:, place])
        return traits

    def readings(self, recorder: Recorder, row: Literal["weather", "weather_before"] = "weather") -> dict[str, Any]:
        """What is read of a row of weather, by the names of ``MEASURED``: recorded values, those without a sensor as they are."""
        true = {name: recorder.input(row, COLUMNS.index(name)) for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")}
        temperature, co2, humidity = air_quantities(true["tOut"], true["co2Out"], true["vpOut"])
        readings = dict(zip(MEASURED, (true["iGlob"], temperature, humidity, co2, true["wind"]), strict=True))
        for place, sensor in enumerate(self.sensors):
            first = self.places.noise + UNIFORMS_PER_NORMAL * place
            normal = approx_normal(*(recorder.input("noise", first + number) for number in range(UNIFORMS_PER_NORMAL)))
            trait = recorder.input("trait", self.places.trait + place)
            readings[sensor.name] = sensor.reading(readings[sensor.name], trait, normal)
        return readings
