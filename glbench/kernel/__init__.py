"""The kernel: one control step of the greenhouse model, for one greenhouse or many, with held inputs.

``make_kernel(900.0)`` gives the fastest kernel that works on this machine; ``make_kernel(900.0, workers=4)`` the same on
four cores, with the same bits. Method, accuracy and speed: docs/kernel.md.
"""

from __future__ import annotations

from glbench.kernel.backends import BACKENDS, Backend, available, why_not_compiled, will_compile
from glbench.kernel.bound import BoundStep
from glbench.kernel.kernel import Kernel
from glbench.kernel.pool import KernelPool, make_kernel
from glbench.kernel.records import Rows, StepFailure
from glbench.kernel.reduced import STATE_SCALE
from glbench.kernel.sensitivities import Adjoint, Linearisation
from glbench.kernel.stepping import Stepper

__all__ = [
    "BACKENDS",
    "STATE_SCALE",
    "Adjoint",
    "Backend",
    "BoundStep",
    "Kernel",
    "KernelPool",
    "Linearisation",
    "Rows",
    "StepFailure",
    "Stepper",
    "available",
    "make_kernel",
    "why_not_compiled",
    "will_compile",
]
