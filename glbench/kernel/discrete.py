"""The control step of a model that is a map: its step is part of the model (``Model.step_map``), and nothing is left to integrate.

All presets are alike. CasADi evaluates the map and its Jacobians, row by row; there is nothing to build.
"""

from __future__ import annotations

from functools import cached_property
from typing import TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from glbench.errors import UnknownNameError, did_you_mean, refuse
from glbench.kernel.cvodes import PRESETS
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure, inputs_in_words
from glbench.kernel.sensitivities import Directions, Forward, Reverse
from glbench.kernel.trajectories import DifferentiatesBySteps, StatesOnly
from glbench.model import Model
from glbench.model.model import evaluate_rows

BoolArray: TypeAlias = npt.NDArray[np.bool_]


class DiscreteBackend(StatesOnly, DifferentiatesBySteps):
    """Steps rows by the map of ``model`` over ``step_seconds`` [s], and differentiates these steps: a backend and its differentiator.

    Raises ``UnknownNameError`` when there is no such preset, and ``ShapeError`` when the model is no map.
    """

    name = "discrete"

    def __init__(self, model: Model, *, step_seconds: float, preset: str) -> None:
        if preset not in PRESETS:
            refuse(f"The kernel has no preset '{preset}'.{did_you_mean(preset, PRESETS)}", UnknownNameError)
        self._model = model
        self._step = model.step_function(step_seconds)

    @cached_property
    def _jacobian(self) -> ca.Function:
        """The derivative of the step with respect to x, u, d and p, side by side."""
        inputs = [ca.SX.sym(key, size) for key, size in self._model.sizes.items()]
        return ca.Function("step_jacobian", inputs, [ca.cse(ca.densify(ca.jacobian(self._step(*inputs), ca.vertcat(*inputs))))])

    def _evaluate(self, function: ca.Function, rows: Rows) -> FloatArray:
        return evaluate_rows(self._model.names, function, rows.x, rows.u, rows.d, rows.p[0] if len(rows.p) == 1 else rows.p)

    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out``; a row whose result is not finite keeps its old state and is reported."""
        after = self._evaluate(self._step, rows)[..., 0]
        failed = np.logical_not(np.isfinite(after).all(axis=1))
        out[:] = np.where(failed[:, None], rows.x, after)
        numbers = np.flatnonzero(failed).tolist()
        return [StepFailure(row, f"the result is not finite; {inputs_in_words(self._model, rows, row)}") for row in numbers]

    def describe(self) -> Description:
        """Return method and versions, as recorded in results."""
        step = self._model.step_map
        assert step is not None
        return {
            "method": f"part of the model: {step.method}, {step.parts} steps of equal length, then the states are limited",
            "casadi": str(ca.CasadiMeta.version()),
        }

    def differentiator(self) -> DiscreteBackend:
        """What differentiates the steps: this backend."""
        return self

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""
        x_next, failed, jacobians = self._linearise(rows)
        tangents = np.zeros((len(rows.x), directions.count, rows.x.shape[1]))
        for key, seeds in directions.seeds.items():
            # Input by input, not as a product of matrices: the libraries for those differ in their last bits.
            for place, column in enumerate(jacobians[key].transpose(2, 0, 1)):
                tangents += seeds[:, :, place, None] * column[:, None]
        return Forward(x_next, tangents, failed)

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, states) back."""
        x_next, failed, jacobians = self._linearise(rows)
        gradients = {key: np.zeros((len(rows.x), jacobian.shape[2])) for key, jacobian in jacobians.items() if key != "p" or parameters}
        for key, gradient in gradients.items():
            for state in range(rows.x.shape[1]):
                gradient += cotangents[:, state, None] * jacobians[key][:, state]
        return Reverse(x_next, gradients, failed)

    def _linearise(self, rows: Rows) -> tuple[FloatArray, BoolArray, dict[str, FloatArray]]:
        """States after the step, which rows failed, and the Jacobian (n, states, inputs) of each input, 0 where the row failed."""
        x_next, failed = np.empty_like(rows.x), np.zeros(len(rows.x), dtype=np.bool_)
        failed[[failure.row for failure in self.advance(rows, x_next)]] = True
        jacobians = np.where(failed[:, None, None], 0.0, self._evaluate(self._jacobian, rows))
        parts = np.split(jacobians, np.cumsum([*self._model.sizes.values()])[:-1], axis=2)
        return x_next, failed, dict(zip(self._model.sizes, parts, strict=True))
