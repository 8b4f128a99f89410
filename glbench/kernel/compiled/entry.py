"""Where the compiled step of environments is, for callers that are not Python."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

from glbench.kernel.compiled.binding import EnvironmentCall
from glbench.kernel.compiled.environment import CompiledEnvironments


@dataclass(frozen=True, eq=False)
class Entry:
    """Addresses of the library's function and of its arguments but the environments themselves; valid as long as this object.

    Attributes
    ----------
    function
        ``glb_environment`` of native/environment.hpp.
    settings, program
        What an ``EnvironmentCall`` of it holds.
    parameters
        How many parameters the model has.
    """

    function: int
    settings: int
    program: int
    parameters: int
    _environments: CompiledEnvironments


def entry_of(environments: CompiledEnvironments) -> Entry:
    """The entry by which any number of environments runs the program of these."""
    call = EnvironmentCall.from_address(environments._step)
    function = ctypes.cast(environments._run, ctypes.c_void_p).value
    assert function is not None
    return Entry(function, call.settings, call.program, environments.parameters.shape[1], environments)
