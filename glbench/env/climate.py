"""Air temperature, CO2 in ppm and relative humidity, as growers and constraints know them, for many rows at once."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from glbench.kernel.tape import Recorder, RecordingError, Value
from glbench.model import STATE_NAMES, co2_ppm, relative_humidity

AIR_STATES = tuple(STATE_NAMES.index(name) for name in ("tAir", "co2Air", "vpAir"))
"""Places of temperature, CO2 density and vapour pressure of the indoor air in the state."""


class AirReader:
    """Converts temperature, CO2 density and vapour pressure of ``n`` parcels of air.

    The model's own functions are evaluated by CasADi, one row after the other with the C library's ``exp``. NumPy's
    ``exp`` is another one on some processors, and its bits would then depend on the machine more than need be.

    An instance owns its buffers: calls must not overlap.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self._input = np.empty((3, n))
        self._output = np.empty((2, n))
        self._buffer, self._evaluate = _conversion(n).buffer()
        for i in range(3):
            self._buffer.set_arg(i, memoryview(self._input[i]))
        for i in range(2):
            self._buffer.set_res(i, memoryview(self._output[i]))

    def __call__(
        self, temperature: NDArray[np.float64], co2_density: NDArray[np.float64], vapour_pressure: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Air temperature [degC], CO2 [ppm], relative humidity [%, 0 to 100], shape ``(3, n)``.

        Parameters
        ----------
        temperature, co2_density, vapour_pressure
            In degC, mg m-3 and Pa, each of shape ``(n,)``.
        """
        self._input[0] = temperature
        self._input[1] = co2_density
        self._input[2] = vapour_pressure
        self._evaluate()
        air = np.empty((3, self.n))
        air[0] = temperature
        air[1:] = self._output
        return air


def record_air(
    temperature: Value, co2_density: Value, vapour_pressure: Value, recorder: Recorder
) -> tuple[Value, Value]:
    """CO2 [ppm] and relative humidity [%] of one parcel, recorded for the compiled kernel: CasADi's operations in CasADi's order."""
    function, given = _function(), (temperature, co2_density, vapour_pressure)
    register: dict[int, Any] = {}
    results: dict[int, Value] = {}
    names = {getattr(casadi, f"OP_{name}"): operator for name, operator in _OPERATORS.items()}
    for k in range(function.n_instructions()):
        operation, operands = function.instruction_id(k), function.instruction_input(k)
        to = function.instruction_output(k)
        if operation == casadi.OP_CONST:
            register[to[0]] = function.instruction_constant(k)
        elif operation == casadi.OP_INPUT:
            register[to[0]] = given[operands[0]]
        elif operation == casadi.OP_OUTPUT:
            results[to[0]] = register[operands[0]]
        elif operation in names:
            register[to[0]] = recorder.operation(names[operation], *(register[operand] for operand in operands))
        else:
            msg = f"The air's formulas use CasADi's operation {operation}, which cannot be recorded."
            raise RecordingError(msg)
    return results[0], results[1]


_OPERATORS = {
    "ADD": "add", "SUB": "subtract", "MUL": "multiply", "DIV": "divide", "NEG": "negative", "FMAX": "fmax", "FMIN": "fmin", "EXP": "exp",
}  # fmt: skip


@lru_cache(maxsize=1)
def _function() -> Any:
    temperature, density, pressure = (casadi.SX.sym(name) for name in ("temperature", "density", "pressure"))
    # The benchmark caps relative humidity: air can be supersaturated for a moment, a hygrometer shows 100 %.
    humidity = casadi.fmax(0.0, casadi.fmin(100.0, relative_humidity(temperature, pressure)))
    return casadi.Function("air", [temperature, density, pressure], [co2_ppm(temperature, density), humidity])


@lru_cache(maxsize=8)
def _conversion(n: int) -> Any:
    return _function().map(n, "serial")
