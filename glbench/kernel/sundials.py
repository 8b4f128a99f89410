"""One control step with CVODES, the BDF integrator of SUNDIALS that comes with CasADi; needs no compiler.

Two backends share the code. ``casadi`` is the default where nothing faster is available: the reduced model, one absolute
tolerance on scaled states. ``cvodes`` is the independent check: the model as written, relative and absolute tolerance.
Figures and reasons: docs/kernel.md and docs/adr/0004-stepping-method.md.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from glbench.errors import UnknownNameError, did_you_mean
from glbench.kernel.bound import PlainBoundStep
from glbench.kernel.environment import Program
from glbench.kernel.finite import all_finite
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure, inputs_in_words
from glbench.kernel.reduced import STATE_SCALE, reduce_model
from glbench.kernel.sensitivities import Differentiator
from glbench.kernel.signals import signals_wait
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES, build_rhs

SUBSTEP_LIMIT = 20_000
"""Most internal steps for one control step; usual are 100 to 400. Beyond it the step is given up and reported."""


@dataclass(frozen=True)
class CvodesSettings:
    """How CVODES is run: tolerances on states divided by ``STATE_SCALE``.

    Attributes
    ----------
    absolute, relative : float
        Local error allowed for each internal step, weighted root mean square over the states.
    newton : float
        Share of the tolerance left to the Newton iterations (CVODES' own default is 0.1).
    hoist : bool
        Whether the reduced model is integrated instead of the model as written.
    """

    absolute: float
    relative: float
    newton: float
    hoist: bool


# A relative tolerance of 1e-30 means "none": CVODES wants it to be positive.
SETTINGS = {
    ("casadi", "reference"): CvodesSettings(absolute=1e-9, relative=1e-30, newton=0.5, hoist=True),
    ("casadi", "standard"): CvodesSettings(absolute=1e-7, relative=1e-30, newton=0.5, hoist=True),
    ("casadi", "fast"): CvodesSettings(absolute=1e-6, relative=1e-30, newton=0.5, hoist=True),
    ("casadi", "tight"): CvodesSettings(absolute=1e-11, relative=1e-30, newton=0.1, hoist=True),
    ("cvodes", "reference"): CvodesSettings(absolute=1e-10, relative=1e-10, newton=0.1, hoist=False),
    ("cvodes", "standard"): CvodesSettings(absolute=1e-7, relative=1e-7, newton=0.1, hoist=False),
    ("cvodes", "fast"): CvodesSettings(absolute=1e-6, relative=1e-6, newton=0.1, hoist=False),
    ("cvodes", "tight"): CvodesSettings(absolute=1e-12, relative=1e-12, newton=0.1, hoist=False),
}
PRESETS = ("reference", "standard", "fast", "tight")

_FLAG = re.compile(r'returned "(CV_\w+)"')


class CvodesBackend:
    """Steps rows one after the other; each row is a fresh start, so its bits depend on its own inputs only.

    Not thread-safe: the integrator's buffers are shared between calls.
    """

    def __init__(self, name: str, *, step_seconds: float, variant: str, preset: str) -> None:
        if preset not in PRESETS:
            msg = f"The kernel has no preset '{preset}'.{did_you_mean(preset, PRESETS)}"
            raise UnknownNameError(msg)
        self.name = name
        self._settings = SETTINGS[name, preset]
        model = reduce_model(variant, hoist=self._settings.hoist)
        self._model = model
        self._scale = STATE_SCALE[model.moving]
        self._step_seconds = step_seconds
        self._rhs = build_rhs(variant)
        self._u = np.zeros(len(CONTROL_NAMES))
        self._d = np.zeros(len(DISTURBANCE_NAMES))
        self._p = np.zeros(len(PARAMETER_NAMES))
        self._held = np.zeros(model.held.numel())
        self._clock_rate = np.zeros(model.clocks.size)
        self._start = np.zeros(model.moving.size)
        self._end = np.zeros(model.moving.size)
        self._prepare = _Buffered(model.prepare, {0: self._u, 1: self._d, 2: self._p}, [self._held, self._clock_rate])
        integrator = ca.integrator(
            "control_step",
            "cvodes",
            {"x": model.z, "p": model.held, "ode": model.rate},
            0.0,
            step_seconds,
            _options(self._settings),
        )
        inputs = {integrator.index_in("x0"): self._start, integrator.index_in("p"): self._held}
        self._integrate = _Buffered(integrator, inputs, [self._end])

    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of every row to ``out``; a row that fails keeps its old state and is reported."""
        shared = rows.p.shape[0] == 1
        if shared:
            self._p[:] = rows.p[0]
        failures = []
        row, count = 0, rows.x.shape[0]
        while row < count:
            with signals_wait() as arrived:
                while row < count and not arrived:
                    if not shared:
                        self._p[:] = rows.p[row]
                    reason = self._step_row(rows.x[row], rows.u[row], rows.d[row], out[row])
                    if reason:
                        failures.append(StepFailure(row, self._in_words(reason, rows, row)))
                    row += 1
        return failures

    def differentiator(self) -> Differentiator:
        """Return what differentiates the steps."""
        from glbench.kernel.sundials_sensitivities import CvodesDifferentiator

        return CvodesDifferentiator(self._model, _options(self._settings), self._step_seconds, self.advance)

    def bind(self, rows: Rows, out: FloatArray) -> PlainBoundStep:
        """A step of these very rows without checks; see ``Kernel.bind``."""
        return PlainBoundStep(self, rows, out)

    def describe(self) -> Description:
        """Return method, tolerances and versions, as recorded in results."""
        return {
            "method": "CVODES, BDF of variable order up to 5, Newton with sparse QR",
            "model_form": "reduced" if self._settings.hoist else "as written",
            "absolute_tolerance": self._settings.absolute,
            "relative_tolerance": self._settings.relative,
            "newton_tolerance": self._settings.newton,
            "substep_limit": float(SUBSTEP_LIMIT),
            "casadi": str(ca.CasadiMeta.version()),
        }

    def environments(self, program: Program, n: int) -> None:
        """None: CasADi's integrators step states only."""

    def _step_row(self, x: FloatArray, u: FloatArray, d: FloatArray, out: FloatArray) -> str:
        """Step one row with the parameters in the buffer; when it fails, give the integrator's own word and keep ``x``."""
        moving, clocks = self._model.moving, self._model.clocks
        self._u[:] = u
        self._d[:] = d
        np.divide(x[moving], self._scale, out=self._start)
        out[:] = x
        self._prepare()
        try:
            self._integrate()
        except RuntimeError as error:
            return str(error)
        if not all_finite(self._end):
            return "the result is not finite"
        out[moving] = self._end * self._scale
        out[clocks] += self._step_seconds * self._clock_rate
        return ""

    def _in_words(self, reason: str, rows: Rows, row: int) -> str:
        p = rows.p[row if rows.p.shape[0] > 1 else 0]
        rates = np.asarray(self._rhs(rows.x[row], rows.u[row], rows.d[row], p)).ravel()
        bad = [f"{STATE_NAMES[k]} ({rows.x[row, k]:.6g})" for k in np.flatnonzero(~np.isfinite(rates))]
        if bad:
            what = f"the rate of change is not finite at the start of the step for {', '.join(bad)}"
        else:
            flag = _FLAG.search(reason)
            if flag is None:
                what = reason
            elif flag[1] == "CV_TOO_MUCH_WORK":
                what = f"more than {SUBSTEP_LIMIT} internal steps were needed"
            else:
                what = f"the integrator CVODES gave up with {flag[1]}"
            k = int(np.argmax(np.abs(rates) / STATE_SCALE))
            what += f"; fastest at its start was {STATE_NAMES[k]} = {rows.x[row, k]:.6g}, changing by {rates[k]:.3g} a second"
        return f"{what}; {inputs_in_words(rows, row)}"


def _options(settings: CvodesSettings) -> dict[str, Any]:
    return {
        "abstol": settings.absolute,
        "reltol": settings.relative,
        "nonlin_conv_coeff": settings.newton,
        "max_num_steps": SUBSTEP_LIMIT,
        # Failures are reported as sentences; nothing is printed from C.
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }


class _Buffered:
    """A CasADi function bound to fixed numpy memory for its inputs and first outputs.

    Calls cost 1 us instead of the 100 us of CasADi's own conversion. CasADi does not keep the memory alive, so this does.
    """

    def __init__(self, function: Any, inputs: dict[int, FloatArray], outputs: list[FloatArray]) -> None:
        self._keep = (function, inputs, outputs)
        self._buffer, self._call = function.buffer()
        for index, values in inputs.items():
            self._buffer.set_arg(index, values.data)
        for index, values in enumerate(outputs):
            self._buffer.set_res(index, values.data)

    def __call__(self) -> None:
        self._call()
