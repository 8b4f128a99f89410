"""The ways of stepping the model, and the choice between them.

``compiled`` is generated C or C++ and the fastest; ``casadi`` works everywhere; ``cvodes`` is the slow, independent check.
``auto`` takes ``compiled`` where it is available, else ``casadi``.

A compiled backend plugs in as the module ``glbench.kernel.compiled.backend`` with

* ``available() -> bool``: cheap, never raises, says whether a library can be loaded or built here;
* ``make_backend(*, step_seconds, variant, preset) -> Backend``.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any, Protocol

from glbench.errors import GlbenchError, UnknownNameError, did_you_mean
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure
from glbench.kernel.sundials import CvodesBackend

BACKENDS = ("compiled", "casadi", "cvodes")
_COMPILED = "glbench.kernel.compiled.backend"


class Backend(Protocol):
    """One way of stepping rows over a fixed control step.

    Contract: row i of ``out`` has the same bits whatever the other rows, their order and earlier calls were.
    """

    name: str

    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out`` (n, 28); failed rows keep their old state and are reported."""
        ...

    def describe(self) -> Description:
        """Return method, tolerances and versions."""
        ...


def available() -> tuple[str, ...]:
    """Names of the backends that work on this machine, fastest first."""
    return tuple(name for name in BACKENDS if name != "compiled" or _compiled_works())


def choose(name: str) -> str:
    """Name of the backend meant by ``name``, which may be ``auto``.

    Raises
    ------
    UnknownNameError
        When there is no backend of that name.
    GlbenchError
        When it exists but does not work here.
    """
    if name == "auto":
        return available()[0]
    if name not in BACKENDS:
        msg = f"The kernel has no backend '{name}'.{did_you_mean(name, ('auto', *BACKENDS))}"
        raise UnknownNameError(msg)
    if name not in available():
        msg = f"The backend '{name}' does not work on this machine. Use 'auto', or one of {', '.join(available())}."
        raise GlbenchError(msg)
    return name


def make_backend(name: str, *, step_seconds: float, variant: str, preset: str) -> Backend:
    """Build the backend meant by ``name``; errors as in ``choose``, and UnknownNameError for variant or preset."""
    chosen = choose(name)
    if chosen == "compiled":
        backend: Backend = _compiled().make_backend(step_seconds=step_seconds, variant=variant, preset=preset)
        return backend
    return CvodesBackend(chosen, step_seconds=step_seconds, variant=variant, preset=preset)


def _compiled_works() -> bool:
    # The folder ``compiled`` may be absent; the module inside it need not exist either.
    if importlib.util.find_spec("glbench.kernel.compiled") is None or importlib.util.find_spec(_COMPILED) is None:
        return False
    return bool(_compiled().available())


def _compiled() -> Any:
    return importlib.import_module(_COMPILED)
