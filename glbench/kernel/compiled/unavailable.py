"""Why the compiled backend cannot be used here."""

from __future__ import annotations

from glbench.errors import GlbenchError


class CompiledUnavailable(GlbenchError):  # noqa: N818  a state of the machine, answered with another backend
    """There is no compiled kernel on this machine; the message says why and what to do. CasADi steps in, more slowly."""
