"""The compiled stepper as a backend of ``glbench.kernel``."""

from __future__ import annotations

from functools import cache

from glbench.kernel.compiled.bound import CompiledBoundStep
from glbench.kernel.compiled.differentiator import CompiledDifferentiator
from glbench.kernel.compiled.environment import CompiledEnvironments
from glbench.kernel.compiled.stepper import CompiledStepper, availability
from glbench.kernel.environment import Program
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure, inputs_in_words


class CompiledBackend:
    """Steps rows with generated C++."""

    name = "compiled"

    def __init__(self, stepper: CompiledStepper) -> None:
        self.stepper = stepper

    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out`` (n, 28); failed rows keep their old state and are reported."""
        if len(rows.x) == 0:
            return []
        status = self.stepper.step_rows(rows.x, rows.u, rows.d, rows.p, out)
        if not status.any():
            return []
        return [
            StepFailure(row, f"{self.stepper.explain(row)} ({inputs_in_words(rows, row)})")
            for row in map(int, status.nonzero()[0])
        ]

    def differentiator(self) -> CompiledDifferentiator:
        """Return what differentiates the steps: a second library, built now if need be.

        Raises
        ------
        CompiledUnavailable
            When it can be neither loaded nor built.
        """
        return CompiledDifferentiator(self.stepper)

    def bind(self, rows: Rows, out: FloatArray) -> CompiledBoundStep:
        """A step of these very rows without checks; see ``Kernel.bind``."""
        return self.stepper.bind(*rows, out)

    def describe(self) -> Description:
        """Return method, tolerances and versions."""
        return self.stepper.describe()

    def environments(self, program: Program, n: int) -> CompiledEnvironments | None:
        """``n`` environments that run ``program`` around the step; None when the program is too large."""
        return self.stepper.environments(program, n)


@cache
def reason_unavailable() -> str | None:
    """None when this backend works on this machine, else why not. The first call may compile, which takes seconds."""
    return availability()


def available() -> bool:
    """Whether this backend works on this machine."""
    return reason_unavailable() is None


def make_backend(*, step_seconds: float, variant: str, preset: str, threads: int = 1) -> CompiledBackend:
    """Build the backend.

    Raises
    ------
    UnknownNameError
        When variant or preset do not exist.
    CompiledUnavailable
        When the library can be neither loaded nor built.
    """
    return CompiledBackend(CompiledStepper(step_seconds, variant=variant, preset=preset, threads=threads))
