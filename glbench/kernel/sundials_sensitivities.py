"""Derivatives of steps by CVODES, from the sensitivity and adjoint equations that CasADi derives and CVODES integrates.

Slow, and owing nothing to the compiled kernel: the independent check of its derivatives. A row with all 44 directions takes about a
second, a reverse sweep a tenth of one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from glbench.kernel.directions import SIZES, Directions
from glbench.kernel.records import FloatArray, Rows, StepFailure
from glbench.kernel.reduced import STATE_SCALE, ReducedModel
from glbench.kernel.sensitivities import Forward, Reverse
from glbench.kernel.signals import signals_wait

Advance = Callable[[Rows, FloatArray], list[StepFailure]]


class CvodesDifferentiator:
    """Differentiates rows one after the other.

    Parameters
    ----------
    model : ReducedModel
        What is integrated.
    options : dict
        Options of the integrator.
    step_seconds : float
        Length of the control step [s].
    advance : callable
        Steps rows; the states that are given back come from it.
    """

    def __init__(self, model: ReducedModel, options: dict[str, Any], step_seconds: float, advance: Advance) -> None:
        self._model = model
        # Directions take part in the choice of the internal steps, or their errors would be nobody's business.
        self._options = options | {"fsens_err_con": True}
        self._step_seconds = step_seconds
        self._advance = advance
        self._along = lru_cache(maxsize=4)(self._step_function.forward)

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""
        x_next, failed = self._step(rows)
        tangents = np.zeros((len(rows.x), directions.count, SIZES["x"]))
        function = self._along(directions.count)
        for row in map(int, np.flatnonzero(~failed)):
            which = 0 if directions.shared else row
            held = {key: np.zeros((size, directions.count)) for key, size in SIZES.items()}
            seeds = (held | {key: table[which].T for key, table in directions.seeds.items()}).values()
            found = self._call(function, rows, row, x_next[row], *seeds)
            failed[row] = found is None
            if found is not None:
                tangents[row] = np.asarray(found).T
        return Forward(x_next, tangents, failed)

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, 28) back."""
        x_next, failed = self._step(rows)
        gradients = {key: np.zeros((len(rows.x), size)) for key, size in SIZES.items()}
        for row in map(int, np.flatnonzero(~failed)):
            found = self._call(self._backward, rows, row, x_next[row], cotangents[row])
            failed[row] = found is None
            if found is not None:
                for gradient, values in zip(gradients.values(), found, strict=True):
                    gradient[row] = np.asarray(values).ravel()
        if not parameters:
            del gradients["p"]
        return Reverse(x_next, gradients, failed)

    def _step(self, rows: Rows) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        x_next = np.empty_like(rows.x)
        failed = np.zeros(len(rows.x), dtype=np.bool_)
        failed[[failure.row for failure in self._advance(rows, x_next)]] = True
        return x_next, failed

    def _call(self, function: Any, rows: Rows, row: int, x_next: FloatArray, *seeds: FloatArray) -> Any:
        """Result of a derivative at a row; None when the integrator gave up."""
        p = rows.p[row if len(rows.p) > 1 else 0]
        with signals_wait():
            try:
                return function(rows.x[row], rows.u[row], rows.d[row], p, x_next, *seeds)
            except RuntimeError:
                return None

    @cached_property
    def _step_function(self) -> Any:
        """The whole step (x, u, d, p) -> x_next as a CasADi function."""
        model = self._model
        moving, clocks = model.moving.tolist(), model.clocks.tolist()
        scale = ca.DM(STATE_SCALE[model.moving])
        problem = {"x": model.z, "p": model.held, "ode": model.rate}
        integrate = ca.integrator("control_step", "cvodes", problem, 0.0, self._step_seconds, self._options)
        x, u, d, p = (ca.MX.sym(key, size) for key, size in SIZES.items())
        held, clock_rate = model.prepare(u, d, p)
        x_next = ca.MX(SIZES["x"], 1)
        x_next[moving] = integrate(x0=x[moving] / scale, p=held)["xf"] * scale
        x_next[clocks] = x[clocks] + self._step_seconds * clock_rate
        return ca.Function("step", [x, u, d, p], [x_next])

    @cached_property
    def _backward(self) -> Any:
        return self._step_function.reverse(1)
