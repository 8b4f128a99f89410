"""The air inside along a trajectory, as constraints know it, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.env.air import AIR, air_quantities
from glbench.errors import GlbenchError, ShapeError
from glbench.kernel.tape import Recorder, TapeDerivatives
from glbench.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AirAlong:
    """Air temperature [degC], CO2 [ppm] and relative humidity [%] of some states.

    Attributes
    ----------
    values
        ``(..., 3)``.
    gradient
        Derivative of each with respect to the states ``(..., 3, s)``. Relative humidity is cut off at 0 and 100 %, as a hygrometer
        shows it; beyond, its derivative is 0.
    """

    values: Floats
    gradient: Floats


def air_of(model: Model, states: ArrayLike) -> AirAlong:
    """The air in ``states`` ``(..., s)`` of ``model``, with the bits of ``Simulation.air``.

    Raises
    ------
    GlbenchError
        When the model has no air.
    ShapeError
        When the states are not those of the model.
    """
    x = np.asarray(states, dtype=np.float64)
    if model.air is None:
        msg = f"{model.id} has no air: its `air` is None."
        raise GlbenchError(msg)
    if x.shape[-1:] != (len(model.states),):
        msg = f"The states have shape {x.shape}; the last axis must have the {len(model.states)} states of {model.id}."
        raise ShapeError(msg)
    values, gradient = np.empty((*x.shape[:-1], len(AIR))), np.zeros((*x.shape[:-1], len(AIR), x.shape[-1]))
    for place, column in enumerate(_air(model)(lambda source, index: x[..., index], {"after": gradient})):
        values[..., place] = column
    return AirAlong(values, gradient)


@lru_cache(maxsize=8)
def _air(model: Model) -> TapeDerivatives:
    assert model.air is not None
    with Recorder() as recorder:
        for place, value in enumerate(
            air_quantities(*(recorder.input("after", model.state_index(name)) for name in model.air))
        ):
            recorder.output("table", place, value)
    return TapeDerivatives(recorder.tape(), [("table", place) for place in range(len(AIR))], ("after",))
