"""Air temperature, CO2 in ppm and relative humidity, as growers and constraints know them, for many rows at once."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from glbench.kernel.tape import Recorder, Tape, with_simplification
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
    values = (temperature, co2_density, vapour_pressure)
    outputs = _tape().play(lambda source, index: values[index])
    return np.stack([temperature, *(values for _, _, values in outputs)])


def air_quantities(temperature: Any, co2_density: Any, vapour_pressure: Any) -> tuple[Any, Any, Any]:
    """The same of one parcel, as expressions of a recorded formula."""
    return (temperature, *with_simplification(_co2_and_humidity, temperature, co2_density, vapour_pressure))


def _co2_and_humidity(temperature: Any, density: Any, pressure: Any) -> tuple[Any, Any]:
    # The benchmark caps relative humidity: air can be supersaturated for a moment, a hygrometer shows 100 %, also when it shows no number.
    humidity = relative_humidity(temperature, pressure)
    capped = casadi.fmax(casadi.if_else(humidity < 100.0, humidity, 100.0), 0.0)
    return co2_ppm(temperature, density), capped


@lru_cache(maxsize=1)
def _tape() -> Tape:
    with Recorder() as recorder:
        values = air_quantities(*(recorder.input("after", index) for index in range(3)))
        for index, value in enumerate(values[1:]):
            recorder.output("table", index, value)
    return recorder.tape()
