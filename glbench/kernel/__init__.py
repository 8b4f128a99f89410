"""The kernel: one control step of a model, for one greenhouse or many, with held inputs.

``make_kernel(TOMATO, 900.0)`` gives the fastest kernel that works on this machine; ``make_kernel(TOMATO, 900.0, workers=4)`` the same
on four cores, with the same bits. Method, accuracy and speed: docs/kernel.md.
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names
from glbench.kernel.kernel import BACKENDS, Backend, Kernel, available, built_libraries, make_kernel, why_not_compiled, will_compile
from glbench.kernel.records import BoundStep, Rows, StepFailure
from glbench.kernel.sensitivities import Adjoint, Linearisation
from glbench.kernel.trajectories import RolloutError, Trajectory, TrajectoryGradient

if TYPE_CHECKING:
    from glbench.kernel.cvodes import state_scale
else:
    __getattr__ = lazy_names(__name__, {"cvodes": ("state_scale",)})

__all__ = [
    "BACKENDS",
    "Adjoint",
    "Backend",
    "BoundStep",
    "Kernel",
    "Linearisation",
    "RolloutError",
    "Rows",
    "StepFailure",
    "Trajectory",
    "TrajectoryGradient",
    "available",
    "built_libraries",
    "make_kernel",
    "state_scale",
    "why_not_compiled",
    "will_compile",
]
