"""One control step of a model, for one greenhouse or a batch of them: the kernel, and the backends that it chooses from.

``compiled`` is generated C++ and by far the fastest; ``casadi`` works everywhere; ``cvodes`` is the slow, independent check.
``auto`` takes ``compiled`` where a library can be loaded or built, else ``casadi``. A model that is a map (``Model.step_map``) has a
backend of its own, ``discrete``, and no other.
"""

from __future__ import annotations

import math
import os
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from glbench.errors import ShapeError, StepError, UnknownNameError, did_you_mean, refuse, whole_number
from glbench.kernel.environment import Environments, Program
from glbench.kernel.records import BoundStep, Description, FloatArray, Rows, StepFailure, as_rows, bound_rows
from glbench.kernel.sensitivities import Differentiator
from glbench.kernel.trajectories import Horizons, Trajectories
from glbench.model import TOMATO, Model

BACKENDS = ("compiled", "casadi", "cvodes")
DISCRETE = "discrete"


class Backend(Protocol):
    """A way of stepping rows over a fixed control step. Row i of ``out`` has the same bits whatever other rows and calls were."""

    name: str

    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out`` (n, states); failed rows keep their old state and are reported."""

    def bind(self, rows: Rows, out: FloatArray) -> BoundStep:
        """A step of these very rows, which are not checked again."""

    def walk(self, horizons: Horizons, states: FloatArray) -> int:
        """Step checked horizons: write ``states`` (T + 1, n, states), whose first is there; gives how many steps all of them took."""

    def describe(self) -> Description:
        """Return method, tolerances and versions."""

    def differentiator(self) -> Differentiator:
        """Return what differentiates the steps; may build a library for some ten seconds."""

    def prepare(self, p: FloatArray) -> None:
        """Build now what steps with parameters ``p`` and their derivatives need."""

    def environments(self, program: Program, n: int) -> Environments | None:
        """``n`` environments that run ``program`` around the step; None where there is no such thing."""


def available(model: Model = TOMATO) -> tuple[str, ...]:
    """Names of the backends that can step ``model`` on this machine, fastest first. The first call may compile for some seconds."""
    if model.step_map is not None:
        return (DISCRETE,)
    return BACKENDS if why_not_compiled(model) is None else tuple(name for name in BACKENDS if name != "compiled")


def choose(name: str, model: Model = TOMATO) -> str:
    """Name of the backend meant by ``name``, which may be ``auto``. Raises ``UnknownNameError`` when it is none, or not for this model."""
    if name == "auto":
        return available(model)[0]
    if model.step_map is not None and name in BACKENDS:
        refuse(f"{model.id} is a map: only the backend '{DISCRETE}' can step it, not '{name}'. Use 'auto'.", UnknownNameError)
    names = BACKENDS if model.step_map is None else available(model)
    if name not in names:
        refuse(f"The kernel has no backend '{name}'.{did_you_mean(name, ('auto', *names))}", UnknownNameError)
    return name


def make_backend(name: str, model: Model, *, step_seconds: float, preset: str, threads: int = 1) -> Backend:
    """Build the backend meant by ``name``.

    CasADi's integrators are not made for ``threads``: only the compiled backend takes more than one. Raises
    ``UnknownNameError`` when backend or preset do not exist, and ``GlbenchError``, with the reason, when the backend does not work here.
    """
    name = choose(name, model)
    if name == DISCRETE:
        from glbench.kernel.discrete import DiscreteBackend

        return DiscreteBackend(model, step_seconds=step_seconds, preset=preset)
    if name == "compiled":
        from glbench.kernel.compiled.stepper import CompiledStepper

        return CompiledStepper(model, step_seconds, preset=preset, threads=threads)
    from glbench.kernel.cvodes import CvodesBackend

    return CvodesBackend(name, model, step_seconds=step_seconds, preset=preset)


def will_compile(model: Model = TOMATO) -> bool:
    """Whether the next kernel for ``model`` is going to be compiled, which takes some seconds, once on a machine."""
    from glbench.kernel.compiled.stepper import is_built

    return model.step_map is None and not is_built(model)


def built_libraries(model: Model, p: FloatArray, *, for_plans: bool = False) -> dict[str, Path]:
    """Files of the compiled libraries of ``model`` in this user's cache; ``for_plans`` they are built first, derivatives included.

    They are those for a greenhouse with parameters ``p`` ``(p,)``.

    By the names that they need in the folder that the variable ``GLBENCH_KERNELS`` names for another process, which then takes them.
    A process that was lent some itself passes these on.
    """
    from glbench.kernel.compiled.library import LENT
    from glbench.kernel.compiled.stepper import built_libraries

    lent = os.environ.get(LENT)
    passed_on = {file.name: file for file in Path(lent).glob("*.*")} if lent else {}
    return passed_on if model.step_map is not None else {**built_libraries(model, p, for_plans=for_plans), **passed_on}


@cache
def why_not_compiled(model: Model = TOMATO) -> str | None:
    """None where the compiled backend works, else the reason in words. The first call may compile for some seconds."""
    if model.step_map is not None:
        return f"{model.id} is a map: its step is part of the model, and is not compiled."
    from glbench.kernel.compiled.stepper import availability

    return availability(model)


class Kernel(Trajectories):
    """x(t + h) from x(t) with controls, weather and parameters held constant in between.

    Row i of a batch gives the same bits as the row stepped alone, whatever the other rows and earlier calls were. Not
    thread-safe. Raises ``UnknownNameError`` for an unknown backend or preset, ``ShapeError`` for a wrong ``step_seconds`` or ``model``.

    A step of ``model``, such as ``glbench.model.TOMATO``, takes ``step_seconds`` [s]. ``backend`` is ``"auto"``, ``"compiled"``,
    ``"casadi"``, ``"cvodes"`` or, of a map, ``"discrete"``, see ``glbench.kernel.kernel``; as an attribute it is the name of the one that
    steps. ``preset`` is ``"reference"`` (what scores are made with: 1e-6 a step, 1e-5 where some states follow), ``"standard"`` (at least
    as accurate as CVODES at 1e-6, which the benchmark's paper used), ``"fast"`` (for training), or ``"tight"`` (to check the others).
    ``threads`` share the rows of a batch; they change no bit, and only the compiled backend uses them.
    """

    def __init__(
        self, model: Model, step_seconds: float = 900.0, *, backend: str = "auto", preset: str = "reference", threads: int = 1
    ) -> None:
        if not isinstance(model, Model):
            refuse(f"A kernel steps a model, such as Kernel(glbench.model.TOMATO, 900.0); got {model!r} in its place.", ShapeError)
        self.model = model
        self.step_seconds = _positive_seconds(step_seconds)
        self.preset = preset
        self.threads = whole_number(threads, "The number of threads")
        if self.threads < 1:
            refuse(f"The number of threads is at least 1, not {self.threads}.", ShapeError)
        self._backend = make_backend(backend, model, step_seconds=self.step_seconds, preset=preset, threads=self.threads)
        self.backend = self._backend.name
        self._names = model.names
        self._differentiator: Differentiator | None = None

    def __reduce__(self) -> tuple[partial[Kernel], tuple[Model, float]]:
        """A copied or pickled kernel is rebuilt with the same settings and backend; its bits are the same."""
        settings: dict[str, Any] = {"backend": self.backend, "preset": self.preset, "threads": self.threads}
        return partial(type(self), **settings), (self.model, self.step_seconds)

    def step(self, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike) -> FloatArray:
        """State after one control step: a new array in the shape of ``x``.

        ``x`` is (states,) or (n, states), in the order and units of ``model.states``; ``u`` (controls,) [0..1], ``d`` (disturbances,) and
        ``p`` (parameters,) are each with or without a leading axis of n. Raises ``ShapeError`` or ``ActionError`` when an input has the
        wrong shape or is not finite, or a control lies outside 0..1. Raises ``StepError`` when a row could not be integrated; says which,
        at which model time and with which inputs.
        """
        rows = as_rows(self._names, x, u, d, p)
        stepped, failures = self.advance(rows)
        if failures:
            raise StepError(self._failure(failures, len(rows.x)))
        return stepped[0] if np.ndim(x) == 1 else stepped

    def try_step(self, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike) -> tuple[FloatArray, list[StepFailure]]:
        """Step a batch (n, states), as ``step`` does, but for rows that fail: they keep their old states and are reported."""
        if np.ndim(x) != 2:
            width = self.model.sizes["x"]
            refuse(f"try_step wants a batch of states (rows, {width}), not the shape {np.shape(x)}; use step for one state.", ShapeError)
        return self.advance(as_rows(self._names, x, u, d, p))

    def advance(self, rows: Rows) -> tuple[FloatArray, list[StepFailure]]:
        """Like ``try_step``, for a caller who has checked the rows already: nothing is looked at again."""
        out = np.empty_like(rows.x)
        return out, self._backend.advance(rows, out)

    def walk(self, horizons: Horizons, states: FloatArray) -> int:
        """Like ``rollout``, for a caller who has checked the horizons already; see ``Trajectories.walk``."""
        return self._backend.walk(horizons, states)

    def step_into(self, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike, out: FloatArray) -> None:
        """The same as ``step``, with the result in an array of the caller's.

        ``out`` takes the states after the step, in the shape of ``x``: C-contiguous float64; it may be ``x``. Rows that fail keep their
        state. Raises ``ShapeError``, ``ActionError`` or ``StepError`` as for ``step``; ShapeError also for an ``out`` that does not fit.
        """
        rows = as_rows(self._names, x, u, d, p)
        _, result = bound_rows(self._names, *rows, out)
        failures = self._backend.advance(rows, result)
        if failures:
            raise StepError(self._failure(failures, len(rows.x)))

    def bind(self, x: FloatArray, u: FloatArray, d: FloatArray, p: FloatArray, out: FloatArray) -> BoundStep:
        """A step of these very arrays, for loops in which every microsecond counts.

        ``step = kernel.bind(x, u, d, p, out)`` looks at shapes once; each ``step()`` then takes the values that the arrays hold at that
        time, and raises StepError when a row fails; the other rows have been stepped then. Controls outside 0..1 are not refused: whoever
        binds a step keeps them inside.

        The arrays are as for ``step``, C-contiguous float64; ``u`` and ``d`` have as many rows as ``x``. ``out`` takes the states after the
        step, in the shape of ``x``; if it is ``x``, every call continues from the last. Raises ``ShapeError`` for a wrong array.
        """
        rows, result = bound_rows(self._names, x, u, d, p, out)
        return self._backend.bind(rows, result)

    def prepare(self, p: FloatArray) -> None:
        """Build now, once on this machine, what steps with parameters ``p`` ``(p,)`` and their derivatives need."""
        self.differentiator()
        self._backend.prepare(p)

    def differentiator(self) -> Differentiator:
        """What differentiates the steps; made at the first call."""
        if self._differentiator is None:
            self._differentiator = self._backend.differentiator()
        return self._differentiator

    def describe(self) -> Description:
        """What made the numbers: backend, method, tolerances, versions, model digest. Recorded in results."""
        return {
            "backend": self.backend,
            "preset": self.preset,
            "step_seconds": self.step_seconds,
            "variant": self.model.variant,
            "model_version": self.model.version,
            "model_digest": self.model.digest,
            **self._backend.describe(),
        }

    def environments(self, program: Program, n: int) -> Environments | None:
        """``n`` environments that run ``program`` around steps of this kernel, in one call a step.

        See docs/adr/0010-fused-environment-step.md. None where the backend steps states only, and for a program that is too large for it.
        """
        return self._backend.environments(program, n)

    def __enter__(self) -> Self:
        """There is nothing to release: ``with`` says how long a kernel is used."""
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def _failure(self, failures: list[StepFailure], count: int) -> str:
        first = failures[0]
        more = f" {len(failures)} of {count} rows failed." if len(failures) > 1 else ""
        return (
            f"The step of {self.step_seconds:g} s failed in row {first.row} of {count}: {first.reason}.{more} "
            "Use try_step to go on with the other rows."
        )


def make_kernel(model: Model, step_seconds: float = 900.0, *, workers: int = 1, backend: str = "auto", preset: str = "reference") -> Kernel:
    """Kernel whose rows ``workers`` cores share, where it is compiled; the bits are the same. Errors as for ``Kernel``."""
    return Kernel(model, step_seconds, backend=backend, preset=preset, threads=whole_number(workers, "The number of workers"))


def _positive_seconds(step_seconds: float) -> float:
    """Check the length of a control step [s]."""
    try:
        seconds = float(step_seconds)
    except (TypeError, ValueError):
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds > 0.0):
        refuse(f"The control step lasts {step_seconds!r} s; it must be a positive, finite number (usual: 300 or 900 s).", ShapeError)
    return seconds
