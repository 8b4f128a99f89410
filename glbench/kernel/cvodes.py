"""One control step with CVODES, the BDF integrator of SUNDIALS that comes with CasADi; needs no compiler.

Two backends share the code. ``casadi`` is the default where nothing faster is available: the reduced model, one absolute
tolerance on scaled states. ``cvodes`` is the independent check: the model as written, relative and absolute tolerance.
Figures and reasons: docs/kernel.md and docs/adr/0004-stepping-method.md.

The reduced model has scaled states, and what stays constant within a step is computed once: controls, weather and parameters are
held, and about 40 % of the operations of the right-hand side depend on nothing else (optics of cover and screens, ventilation
coefficients, ...). They are moved into a function that runs once a step. A clock, a state with constant rate that nothing depends on,
is not integrated at all: x + h*rate is its exact solution, free of the rounding of many small steps.
"""

from __future__ import annotations

import contextlib
import re
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from glbench.errors import UnknownNameError, did_you_mean, refuse
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure, all_finite, inputs_in_words
from glbench.kernel.sensitivities import Differentiator, Directions, Forward, Reverse
from glbench.kernel.trajectories import DifferentiatesBySteps, StatesOnly
from glbench.model import Model
from glbench.model.expressions import simplification

IndexArray: TypeAlias = npt.NDArray[np.intp]


def state_scale(model: Model) -> FloatArray:
    """Typical size of each state, in its own unit (10 °C for temperatures); an error is judged relative to it."""
    return np.array([state.scale for state in model.states])


@dataclass(frozen=True)
class ReducedModel:
    """Scaled rates ``dz/dt`` of ``z = x[moving] / scale``, as CasADi SX expressions.

    ``moving`` are the states that are integrated, ``scale`` their typical sizes; ``clocks`` are those that run at a constant rate.
    ``constants`` are symbols for all values that are constant within a step; ``rate`` is dz/dt [s-1] as an expression of ``z`` and
    ``constants``. ``prepare`` goes from (u, d, p) to the values of ``constants`` and the rates of the clocks [unit of the state per s].
    """

    moving: IndexArray
    clocks: IndexArray
    scale: FloatArray
    z: Any
    constants: Any
    rate: Any
    prepare: Any


@simplification(on=True)
def reduce_model(model: Model, *, hoist: bool = True) -> ReducedModel:
    """Build the reduced model; with ``hoist=False`` the constants values are simply (u, d, p)."""
    z, u, d, p = (ca.SX.sym("z" if key == "x" else key, size) for key, size in model.sizes.items())
    inputs = ca.vertcat(u, d, p)
    sizes = state_scale(model)
    scale = ca.DM(sizes)
    rate = model.rhs_function()(z * scale, u, d, p) / scale
    # A clock depends on no state, and no state depends on it.
    rows, columns = ca.jacobian(rate, z).sparsity().get_triplet()
    clocks = np.array(sorted({*range(len(sizes))} - {*rows} - {*columns}), dtype=np.intp)
    moving = np.setdiff1d(np.arange(len(sizes)), clocks)
    clock_rate = (rate * scale)[clocks.tolist()]
    z, rate = z[moving.tolist()], rate[moving.tolist()]
    constants, value_of_constants = inputs, inputs
    if hoist:
        rate, symbols, values = ca.extract_parametric(ca.cse(rate), inputs)
        rate = ca.cse(rate)
        constants, value_of_constants = ca.vertcat(*symbols, inputs), ca.vertcat(*values, inputs)
        # Only what the remaining expression still reads is handed to the integrator.
        used = [index for index, needed in enumerate(ca.which_depends(rate, constants, 1, False)) if needed]
        constants, value_of_constants = constants[used], ca.cse(value_of_constants[used])
    prepare = ca.Function("prepare", [u, d, p], [ca.densify(value_of_constants), ca.densify(clock_rate)])
    return ReducedModel(moving, clocks, sizes[moving], z, constants, rate, prepare)


SUBSTEP_LIMIT = 20_000
"""Most internal steps for one control step; usual are 100 to 400. Beyond it the step is given up and reported."""


@dataclass(frozen=True)
class CvodesSettings:
    """How CVODES is run: tolerances on states divided by their scale.

    ``absolute`` and ``relative`` are the local error allowed for each internal step, weighted root mean square over the states, and
    ``newton`` is the share of it left to the Newton iterations (CVODES' own default is 0.1). With ``hoist``, the reduced model is
    integrated instead of the model as written.
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


class CvodesBackend(StatesOnly):
    """Steps rows one after the other; each row is a fresh start, so its bits depend on its own inputs only.

    Not thread-safe: the integrator's buffers are shared between calls.
    """

    def __init__(self, name: str, model: Model, *, step_seconds: float, preset: str) -> None:
        if preset not in PRESETS:
            refuse(f"The kernel has no preset '{preset}'.{did_you_mean(preset, PRESETS)}", UnknownNameError)
        self.name = name
        self._settings = SETTINGS[name, preset]
        self._model = model
        reduced = self._reduced = reduce_model(model, hoist=self._settings.hoist)
        self._step_seconds = step_seconds
        self._u, self._d, self._p = (np.zeros(model.sizes[key]) for key in "udp")
        self._constants = np.zeros(reduced.constants.numel())
        self._clock_rate = np.zeros(reduced.clocks.size)
        self._start = np.zeros(reduced.moving.size)
        self._end = np.zeros(reduced.moving.size)
        self._prepare = _Buffered(reduced.prepare, {0: self._u, 1: self._d, 2: self._p}, [self._constants, self._clock_rate])
        equations = {"x": reduced.z, "p": reduced.constants, "ode": reduced.rate}
        integrator = ca.integrator("control_step", "cvodes", equations, 0.0, step_seconds, _options(self._settings))
        inputs = {integrator.index_in("x0"): self._start, integrator.index_in("p"): self._constants}
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
        return CvodesDifferentiator(self._model.sizes, self._reduced, _options(self._settings), self._step_seconds, self.advance)

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

    def _step_row(self, x: FloatArray, u: FloatArray, d: FloatArray, out: FloatArray) -> str:
        """Step one row with the parameters in the buffer; when it fails, give the integrator's own word and keep ``x``."""
        moving, clocks, scale = self._reduced.moving, self._reduced.clocks, self._reduced.scale
        self._u[:] = u
        self._d[:] = d
        np.divide(x[moving], scale, out=self._start)
        out[:] = x
        self._prepare()
        try:
            self._integrate()
        except RuntimeError as error:
            return str(error)
        if not all_finite(self._end):
            return "the result is not finite"
        out[moving] = self._end * scale
        out[clocks] += self._step_seconds * self._clock_rate
        return ""

    def _in_words(self, reason: str, rows: Rows, row: int) -> str:
        p = rows.p[row if rows.p.shape[0] > 1 else 0]
        names = self._model.state_names
        rates = np.asarray(self._model.rhs_function()(rows.x[row], rows.u[row], rows.d[row], p)).ravel()
        bad = [f"{names[k]} ({rows.x[row, k]:.6g})" for k in np.flatnonzero(~np.isfinite(rates))]
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
            k = int(np.argmax(np.abs(rates) / state_scale(self._model)))
            what += f"; fastest at its start was {names[k]} = {rows.x[row, k]:.6g}, changing by {rates[k]:.3g} a second"
        return f"{what}; {inputs_in_words(self._model, rows, row)}"


def paper_cvodes(model: Model, tolerance: float, step_seconds: float, *, jit: bool = False) -> Any:
    """CasADi's CVODES as the paper runs it: equal absolute and relative tolerance on unscaled states.

    With ``jit`` the model is compiled by gcc, which CasADi does in the working directory and leaves its files there.
    """
    x, u, d = (ca.SX.sym(key, model.sizes[key]) for key in "xud")
    rate = model.rhs_function()(x, u, d, model.parameters.default())
    options: dict[str, Any] = {"abstol": tolerance, "reltol": tolerance, "max_num_steps": 100_000}
    if jit:
        options |= {
            "jit": True,
            "jit_cleanup": False,
            "compiler": "shell",
            "jit_options": {"flags": ["-O3", "-march=native"], "verbose": False, "cleanup": False},
        }
    return ca.integrator("cvodes_step", "cvodes", {"x": x, "p": ca.vertcat(u, d), "ode": rate}, 0.0, step_seconds, options)


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


class CvodesDifferentiator(DifferentiatesBySteps):
    """Differentiates rows one after the other, from the sensitivity and adjoint equations that CasADi derives and CVODES integrates.

    Slow, and owing nothing to the compiled kernel: the independent check of its derivatives. For the tomato, a row with all 44
    directions takes about a second, a reverse sweep a tenth of one.

    ``sizes`` are those of x, u, d and p, ``options`` those of the integrator; the states that are given back come from ``advance``.
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        model: ReducedModel,
        options: dict[str, Any],
        step_seconds: float,
        advance: Callable[[Rows, FloatArray], list[StepFailure]],
    ) -> None:
        self._sizes = sizes
        self._model = model
        # Directions take part in the choice of the internal steps, or their errors would be ignored.
        self._options = options | {"fsens_err_con": True}
        self._step_seconds = step_seconds
        self._advance = advance
        self._along, self._backward = (lru_cache(maxsize=4)(make) for make in (self._step_function.forward, self._step_function.reverse))

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""
        x_next, failed = self._step(rows)
        tangents = np.zeros((len(rows.x), directions.count, self._sizes["x"]))
        function = self._along(directions.count)
        for row in map(int, np.flatnonzero(~failed)):
            which = 0 if directions.shared else row
            zeros = {key: np.zeros((size, directions.count)) for key, size in self._sizes.items()}
            seeds = (zeros | {key: table[which].T for key, table in directions.seeds.items()}).values()
            result = self._call(function, rows, row, x_next[row], *seeds)
            failed[row] = result is None
            if result is not None:
                tangents[row] = np.asarray(result).T
        return Forward(x_next, tangents, failed)

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, states) back."""
        x_next, failed = self._step(rows)
        gradients = {key: np.zeros((len(rows.x), size)) for key, size in self._sizes.items()}
        function = self._backward(1)
        for row in map(int, np.flatnonzero(~failed)):
            result = self._call(function, rows, row, x_next[row], cotangents[row])
            failed[row] = result is None
            if result is not None:
                for gradient, values in zip(gradients.values(), result, strict=True):
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
    @simplification(on=True)
    def _step_function(self) -> Any:
        """The whole step (x, u, d, p) -> x_next as a CasADi function."""
        model = self._model
        moving, clocks = model.moving.tolist(), model.clocks.tolist()
        scale = ca.DM(model.scale)
        problem = {"x": model.z, "p": model.constants, "ode": model.rate}
        integrate = ca.integrator("control_step", "cvodes", problem, 0.0, self._step_seconds, self._options)
        x, u, d, p = (ca.MX.sym(key, size) for key, size in self._sizes.items())
        constants, clock_rate = model.prepare(u, d, p)
        x_next = ca.MX(self._sizes["x"], 1)
        x_next[moving] = integrate(x0=x[moving] / scale, p=constants)["xf"] * scale
        if clocks:
            x_next[clocks] = x[clocks] + self._step_seconds * clock_rate
        return ca.Function("step", [x, u, d, p], [x_next])


# Signals that programs handle in Python; those that do not exist on a platform are left out.
_NUMBERS = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGUSR1", "SIGUSR2", "SIGCHLD")
    if hasattr(signal, name)
)


@contextlib.contextmanager
def signals_wait() -> Iterator[list[int]]:
    """Keep Python's signal handlers waiting: give the list of those that have arrived so far, and raise them at the end, once each.

    While an integrator runs, CasADi lets Python handle pending signals at every evaluation of the right-hand side. When a handler
    raises, as it does for Ctrl-C, CasADi takes that for a failed evaluation and swallows the exception: the row would be reported
    as not integrable and the program would go on. So handlers wait until the integrator has returned, some milliseconds later.

    Entering and leaving costs about 20 us, so enter it once for many rows and leave when something has arrived.
    """
    arrived: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield arrived  # Python handles signals nowhere but in the main thread
        return
    # The stack puts every handler back, even if one that did come through in between raises.
    with contextlib.ExitStack() as stack:
        for number in _NUMBERS:
            handler = signal.getsignal(number)
            if callable(handler):
                stack.callback(signal.signal, number, handler)
                signal.signal(number, lambda number, _frame: arrived.append(number))
        yield arrived
    for number in dict.fromkeys(arrived):
        signal.raise_signal(number)
