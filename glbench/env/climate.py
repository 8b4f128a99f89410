"""Air temperature, CO2 in ppm and relative humidity, as growers and constraints know them, for many rows at once."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from glbench.env.formulas import record_function
from glbench.kernel.tape import Recorder, Tape, Value
from glbench.model import co2_ppm, relative_humidity
from glbench.quantities import AIR as _AIR

AIR = {name: entry.unit for name, entry in _AIR.items()}
"""What is known of the air, with units."""


def read_air(
    temperature: NDArray[np.float64], co2_density: NDArray[np.float64], vapour_pressure: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Air temperature [degC], CO2 [ppm], relative humidity [%, 0 to 100], shape ``(3, n)``.

    Parameters
    ----------
    temperature, co2_density, vapour_pressure
        In degC, mg m-3 and Pa, each of shape ``(n,)``.
    """
    given = (temperature, co2_density, vapour_pressure)
    outputs = _tape().play(lambda source, index: given[index])
    return np.stack([temperature, *(values for _, _, values in outputs)])


def record_air(
    temperature: Value, co2_density: Value, vapour_pressure: Value, recorder: Recorder
) -> tuple[Value, Value]:
    """CO2 [ppm] and relative humidity [%] of one parcel, recorded: CasADi's operations in CasADi's order, as everywhere in the model."""
    ppm, humidity = record_function(_function(), (temperature, co2_density, vapour_pressure), recorder)
    return ppm, humidity


@lru_cache(maxsize=1)
def _tape() -> Tape:
    recorder = Recorder()
    temperature, density, pressure = (recorder.input("after", index) for index in range(3))
    for index, value in enumerate(record_air(temperature, density, pressure, recorder)):
        recorder.output("table", index, value)
    return recorder.tape()


@lru_cache(maxsize=1)
def _function() -> Any:
    temperature, density, pressure = (casadi.SX.sym(name) for name in ("temperature", "density", "pressure"))
    # The benchmark caps relative humidity: air can be supersaturated for a moment, a hygrometer shows 100 %.
    humidity = casadi.fmax(0.0, casadi.fmin(100.0, relative_humidity(temperature, pressure)))
    return casadi.Function("air", [temperature, density, pressure], [co2_ppm(temperature, density), humidity])
