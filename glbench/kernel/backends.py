"""The ways of stepping a model, and the choice between them.

``compiled`` is generated C++ and by far the fastest; ``casadi`` works everywhere; ``cvodes`` is the slow, independent check.
``auto`` takes ``compiled`` where a library can be loaded or built, else ``casadi``.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Protocol

from glbench.errors import UnknownNameError, did_you_mean
from glbench.kernel.environment import Environments, Program
from glbench.kernel.horizons import Horizons
from glbench.kernel.records import BoundStep, Description, FloatArray, Rows, StepFailure
from glbench.kernel.sensitivities import Differentiator
from glbench.kernel.sundials import CvodesBackend
from glbench.model import TOMATO, Model

BACKENDS = ("compiled", "casadi", "cvodes")


class Backend(Protocol):
    """One way of stepping rows over a fixed control step.

    Contract: row i of ``out`` has the same bits whatever the other rows, their order and earlier calls were.
    """

    name: str

    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out`` (n, states); failed rows keep their old state and are reported."""
        ...

    def bind(self, rows: Rows, out: FloatArray) -> BoundStep:
        """A step of these very rows, which are not checked again."""
        ...

    def walk(self, horizons: Horizons, states: FloatArray) -> int:
        """Step checked horizons: write ``states`` (T + 1, n, states), whose first is there; gives how many steps all of them took."""
        ...

    def describe(self) -> Description:
        """Return method, tolerances and versions."""
        ...

    def differentiator(self) -> Differentiator:
        """Return what differentiates the steps; may build a library for some ten seconds."""
        ...

    def environments(self, program: Program, n: int) -> Environments | None:
        """``n`` environments that run ``program`` around the step; None where there is no such thing."""
        ...


def available(model: Model = TOMATO) -> tuple[str, ...]:
    """Names of the backends that can step ``model`` on this machine, fastest first. The first call may compile for some seconds."""
    return BACKENDS if why_not_compiled(model) is None else tuple(name for name in BACKENDS if name != "compiled")


def choose(name: str, model: Model = TOMATO) -> str:
    """Name of the backend meant by ``name``, which may be ``auto``.

    Raises
    ------
    UnknownNameError
        When there is no backend of that name.
    """
    if name == "auto":
        return available(model)[0]
    if name not in BACKENDS:
        msg = f"The kernel has no backend '{name}'.{did_you_mean(name, ('auto', *BACKENDS))}"
        raise UnknownNameError(msg)
    return name


def make_backend(name: str, model: Model, *, step_seconds: float, preset: str, threads: int = 1) -> Backend:
    """Build the backend meant by ``name``.

    CasADi's integrators are not made for ``threads``: only the compiled backend takes more than one.

    Raises
    ------
    UnknownNameError
        When backend or preset do not exist.
    GlbenchError
        When the backend does not work on this machine, with the reason.
    """
    chosen = choose(name, model)
    if chosen == "compiled":
        from glbench.kernel.compiled.stepper import CompiledStepper

        return CompiledStepper(model, step_seconds, preset=preset, threads=threads)
    return CvodesBackend(chosen, model, step_seconds=step_seconds, preset=preset)


def will_compile(model: Model = TOMATO) -> bool:
    """Whether the next kernel for ``model`` is going to be compiled, which takes some seconds, once on a machine."""
    from glbench.kernel.compiled.stepper import is_built

    return not is_built(model)


def built_libraries(model: Model, *, for_plans: bool = False) -> dict[str, Path]:
    """Files of the compiled libraries of ``model`` in this user's cache; ``for_plans`` they are built first, derivatives included.

    By the names that they need in the folder that the variable ``GLBENCH_KERNELS`` names for another process, which then takes them.
    A process that was lent some itself passes these on.
    """
    from glbench.kernel.compiled.library import LENT
    from glbench.kernel.compiled.stepper import built_libraries

    lent = os.environ.get(LENT)
    passed_on = {file.name: file for file in Path(lent).glob("*.*")} if lent else {}
    return {**built_libraries(model, for_plans=for_plans), **passed_on}


@cache
def why_not_compiled(model: Model = TOMATO) -> str | None:
    """None where the compiled backend works, else the reason in words. The first call may compile for some seconds."""
    from glbench.kernel.compiled.stepper import availability

    return availability(model)
