"""The model as integrators like it: scaled states, and everything that stays constant within a step computed once.

Within a control step the controls, the weather and the parameters are held. About 40 % of the operations of the right-hand
side depend on nothing else (optics of cover and screens, ventilation coefficients, ...). They are moved into a function
that runs once a step; the integrator only sees what depends on the state. A clock, a state with constant rate that nothing
depends on, is not integrated at all: x + h*rate is its exact solution, free of the rounding of many small steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from glbench.kernel.records import FloatArray
from glbench.model import Model

IndexArray: TypeAlias = npt.NDArray[np.intp]


def state_scale(model: Model) -> FloatArray:
    """Typical size of each state, in its own unit (10 °C for temperatures); an error is judged relative to it."""
    return np.array([state.scale for state in model.states])


@dataclass(frozen=True)
class ReducedModel:
    """Scaled rates ``dz/dt`` of ``z = x[moving] / scale``, as CasADi SX expressions.

    Attributes
    ----------
    moving, clocks : IndexArray
        States that are integrated, and those that run at a constant rate.
    scale : FloatArray
        Typical sizes of the moving states.
    z, held : casadi.SX
        Scaled moving states, and symbols for all values that are constant within a step.
    rate : casadi.SX
        dz/dt [s-1] as an expression of ``z`` and ``held``.
    prepare : casadi.Function
        (u, d, p) -> (values of ``held``, rates of the clocks [unit of the state per s]).
    """

    moving: IndexArray
    clocks: IndexArray
    scale: FloatArray
    z: Any
    held: Any
    rate: Any
    prepare: Any


def reduce_model(model: Model, *, hoist: bool = True) -> ReducedModel:
    """Build the reduced model; with ``hoist=False`` the held values are simply (u, d, p)."""
    z, u, d, p = (ca.SX.sym("z" if key == "x" else key, size) for key, size in model.sizes.items())
    inputs = ca.vertcat(u, d, p)
    sizes = state_scale(model)
    scale = ca.DM(sizes)
    rate = model.rhs_function()(z * scale, u, d, p) / scale
    clocks = _clocks(ca.jacobian(rate, z).sparsity())
    moving = np.setdiff1d(np.arange(len(sizes)), clocks)
    clock_rate = (rate * scale)[clocks.tolist()]
    z, rate = z[moving.tolist()], rate[moving.tolist()]
    held, value_of_held = inputs, inputs
    if hoist:
        rate, symbols, values = ca.extract_parametric(ca.cse(rate), inputs)
        rate = ca.cse(rate)
        held, value_of_held = ca.vertcat(*symbols, inputs), ca.vertcat(*values, inputs)
        # Only what the remaining expression still reads is handed to the integrator.
        used = [index for index, needed in enumerate(ca.which_depends(rate, held, 1, False)) if needed]
        held, value_of_held = held[used], ca.cse(value_of_held[used])
    prepare = ca.Function("prepare", [u, d, p], [ca.densify(value_of_held), ca.densify(clock_rate)])
    return ReducedModel(moving, clocks, sizes[moving], z, held, rate, prepare)


def _clocks(dependence: Any) -> IndexArray:
    """States that depend on no state and that no state depends on, from the sparsity of the Jacobian."""
    rows, columns = dependence.get_triplet()
    return np.array(sorted({*range(dependence.size1())} - {*rows} - {*columns}), dtype=np.intp)
