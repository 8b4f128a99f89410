"""Sensors of the weather that err: what agents and the process computer read; what acts on the greenhouse is the truth.

The reading of a quantity q in step k of a run is

    r(k) = a q(k) (1 + s w(k))      of global radiation and wind speed,
    r(k) = q(k) + b + s w(k)        of temperature and relative humidity,

with a scale a of the run, drawn evenly between its limits; a bias b of the run, approximately normal with the stated standard deviation;
and noise w(k), approximately normal and new in every step. The reading stays within the bounds of its column. A soiled dome or a mast of
another height are factors. Sums since midnight have a reading for each step, with the noise of its end. See docs/uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from glbench.arrays import Floats
from glbench.env.air import air_quantities
from glbench.env.memory_layout import DrawPlaces
from glbench.env.random import UNIFORMS_PER_NORMAL, approx_normal
from glbench.errors import TaskError, refuse
from glbench.kernel.tape import Recorder
from glbench.quantities import OUTDOOR
from glbench.tasks import TaskSpec
from glbench.tasks.tables import PROCESS_COMPUTER, OffsetSensorTable, ScaledSensorTable
from glbench.weather import COLUMNS

MEASURED = ("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "outdoor_co2", "wind_speed")
"""What is read outside, in the order of ``WeatherTables.measured``."""


@dataclass(frozen=True)
class OutdoorSensors:
    """The sensors of the weather that err, by the names of ``MEASURED``, and where what they draw begins."""

    sensors: Mapping[str, ScaledSensorTable | OffsetSensorTable]
    places: DrawPlaces

    STREAM: ClassVar[str] = "outdoor sensors"
    TRAIT_STREAM: ClassVar[str] = "outdoor sensor offsets"

    @staticmethod
    def of(task: TaskSpec, places: DrawPlaces) -> OutdoorSensors:
        """The sensors of a task; of a task without any, nothing. Raises ``TaskError`` when nobody reads them."""
        table, modules = task.outdoor_sensors, task.observation.modules
        if table is not None and task.actuation.kind != PROCESS_COMPUTER and not {"weather", "light_today"} & {*modules}:
            refuse(f"{task.source}: [outdoor_sensors] nobody reads them. Leave the table out, or add the module 'weather'.", TaskError)
        return OutdoorSensors({} if table is None else dict(table.items()), places)

    @property
    def middles(self) -> Floats:
        """Middle of the scale of each of ``MEASURED`` ``(5,)``: what a reading is best divided by while nothing more is known."""
        scales = {name: (one.scale.low + one.scale.high) / 2.0 for name, one in self.sensors.items() if isinstance(one, ScaledSensorTable)}
        return np.array([scales.get(name, 1.0) for name in MEASURED])

    @property
    def spreads(self) -> dict[str, tuple[float, bool]]:
        """How far weather is from readings over ``middles``: by column a standard deviation, and whether it is a share."""
        spreads = {}
        for name, column in (("global_radiation", "iGlob"), ("outdoor_temperature", "tOut"), ("wind_speed", "wind")):
            match self.sensors.get(name):
                case ScaledSensorTable(scale=scale):
                    spreads[column] = ((scale.high - scale.low) / (scale.high + scale.low) / np.sqrt(3.0), True)
                case OffsetSensorTable(bias=bias):
                    spreads[column] = (bias, False)
        return spreads

    @property
    def numbers(self) -> int:
        """Random numbers needed in a step, and as many once a run."""
        return UNIFORMS_PER_NORMAL * len(self.sensors)

    trait_numbers = numbers

    @property
    def trait_count(self) -> int:
        """A scale or a bias of each sensor."""
        return len(self.sensors)

    def traits(self, numbers: Floats) -> Floats:
        """Scale or bias of each sensor, ``(n, sensors)``, from ``trait_numbers`` uniform numbers a run."""
        traits = np.zeros((len(numbers), len(self.sensors)))
        for place, sensor in enumerate(self.sensors.values()):
            own = numbers[:, UNIFORMS_PER_NORMAL * place : UNIFORMS_PER_NORMAL * (place + 1)]
            if isinstance(sensor, ScaledSensorTable):
                traits[:, place] = sensor.scale.low + (sensor.scale.high - sensor.scale.low) * own[:, 0]
            else:
                traits[:, place] = approx_normal(*own.T) * sensor.bias
        return traits

    def readings(self, recorder: Recorder, row: Literal["weather", "weather_before"] = "weather") -> dict[str, Any]:
        """What is read of a row of weather, by the names of ``MEASURED``: recorded values, those without a sensor as they are."""
        radiation, *parcel, wind = (recorder.input(row, COLUMNS.index(name)) for name in ("iGlob", "tOut", "co2Out", "vpOut", "wind"))
        temperature, co2, humidity = air_quantities(*parcel)
        readings = dict(zip(MEASURED, (radiation, temperature, humidity, co2, wind), strict=True))
        for place, (name, sensor) in enumerate(self.sensors.items()):
            first, true = self.places.noise + UNIFORMS_PER_NORMAL * place, readings[name]
            noise = approx_normal(*(recorder.input("noise", first + number) for number in range(UNIFORMS_PER_NORMAL))) * sensor.noise
            trait = recorder.input("trait", self.places.trait + place)
            reading = true * trait * (1.0 + noise) if isinstance(sensor, ScaledSensorTable) else true + trait + noise
            readings[name] = np.minimum(np.maximum(reading, OUTDOOR[name].low), OUTDOOR[name].high)
        return readings
