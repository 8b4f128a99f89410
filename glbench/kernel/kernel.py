"""One control step of the model, for one greenhouse or a batch of them, in this process."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from glbench.errors import StepError, whole_number
from glbench.kernel.backends import make_backend
from glbench.kernel.bound import BoundStep, bound_rows
from glbench.kernel.environment import Environments, Program
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure, as_rows
from glbench.kernel.sensitivities import Differentiator
from glbench.kernel.stepping import Stepper, positive_seconds
from glbench.model import MODEL_VERSION, model_digest


class Kernel(Stepper):
    """Steps rows in this process.

    Parameters
    ----------
    step_seconds : float
        Length h of the control step [s], positive.
    variant : str
        Model variant, see ``glbench.model.VARIANTS``.
    backend : str
        ``"auto"``, ``"compiled"``, ``"casadi"`` or ``"cvodes"``, see ``glbench.kernel.backends``.
    preset : str
        ``"reference"`` (what scores are made with: 1e-6 a step), ``"standard"`` (at least as accurate as CVODES at 1e-6, which
        the benchmark's paper used), ``"fast"`` (for training), or ``"tight"`` (to check the others against).
    threads : int
        Threads that share the rows of a batch. They change no bit, and only the compiled backend uses them.

    Raises
    ------
    UnknownNameError
        When variant, backend or preset do not exist.
    ShapeError
        When ``step_seconds`` is not a positive, finite number.
    """

    def __init__(
        self,
        step_seconds: float = 900.0,
        *,
        variant: str = "author",
        backend: str = "auto",
        preset: str = "reference",
        threads: int = 1,
    ) -> None:
        self.step_seconds = positive_seconds(step_seconds)
        threads = whole_number(threads, "The number of threads")
        self.variant = variant
        self.preset = preset
        self.threads = threads
        self._backend = make_backend(
            backend, step_seconds=self.step_seconds, variant=variant, preset=preset, threads=threads
        )
        self.backend = self._backend.name
        self._differentiator: Differentiator | None = None

    def __reduce__(self) -> tuple[partial[Kernel], tuple[float]]:
        """A copied or pickled kernel is made anew with the same settings and backend; its bits are the same."""
        settings: dict[str, Any] = {
            "variant": self.variant,
            "backend": self.backend,
            "preset": self.preset,
            "threads": self.threads,
        }
        return partial(type(self), **settings), (self.step_seconds,)

    def advance(self, rows: Rows) -> tuple[FloatArray, list[StepFailure]]:
        """Step checked rows; see ``Stepper.advance``."""
        out = np.empty_like(rows.x)
        return out, self._backend.advance(rows, out)

    def differentiator(self) -> Differentiator:
        """What differentiates the steps; made at the first call."""
        if self._differentiator is None:
            self._differentiator = self._backend.differentiator()
        return self._differentiator

    def step_into(
        self, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike, out: FloatArray
    ) -> None:
        """The same as ``step``, with the result in an array of the caller's.

        Parameters
        ----------
        x, u, d, p : array_like
            As for ``step``.
        out : ndarray
            States after the step, in the shape of ``x``: C-contiguous float64; may be ``x``. Rows that fail keep their state.

        Raises
        ------
        ShapeError, ActionError, StepError
            As for ``step``; ShapeError also for an ``out`` that does not fit.
        """
        rows = as_rows(x, u, d, p)
        _, result = bound_rows(rows.x, rows.u, rows.d, rows.p, out)
        failures = self._backend.advance(rows, result)
        if failures:
            raise StepError(self._failure(failures, rows.x.shape[0]))

    def bind(self, x: FloatArray, u: FloatArray, d: FloatArray, p: FloatArray, out: FloatArray) -> BoundStep:
        """A step of these very arrays, for loops in which every microsecond counts.

        ``step = kernel.bind(x, u, d, p, out)`` looks at shapes once; each ``step()`` then takes the values that the arrays hold
        at that time. Controls outside 0..1 are not refused: whoever binds a step keeps them inside.

        Parameters
        ----------
        x, u, d, p : ndarray
            As for ``step``, C-contiguous float64; ``u`` and ``d`` have as many rows as ``x``.
        out : ndarray
            States after the step, in the shape of ``x``; may be ``x``: then every call goes on from the last.

        Returns
        -------
        BoundStep
            Call it without arguments. It raises StepError when a row fails; the other rows have been stepped then.

        Raises
        ------
        ShapeError
            When an array has another shape, type or layout.
        """
        rows, result = bound_rows(x, u, d, p, out)
        return self._backend.bind(rows, result)

    def describe(self) -> Description:
        """What made the numbers; see ``Stepper.describe``."""
        return {
            "backend": self.backend,
            "preset": self.preset,
            "step_seconds": self.step_seconds,
            "variant": self.variant,
            "model_version": MODEL_VERSION,
            "model_digest": model_digest(self.variant),
            **self._backend.describe(),
        }

    def environments(self, program: Program, n: int) -> Environments | None:
        """``n`` environments that run ``program`` around steps of this kernel, in one call a step.

        See docs/adr/0010-fused-environment-step.md. None where the backend steps states only, and for a program that is too large for it.
        """
        return self._backend.environments(program, n)

    def close(self) -> None:
        """Nothing to release; there so that a kernel and a pool can be used alike."""
