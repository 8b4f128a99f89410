"""The kernel that environments share, made when the first reset needs it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from glbench.kernel import Kernel, StepFailure


class Stepper(Protocol):
    """What a simulation needs of a kernel; ``glbench.kernel.Kernel`` and ``KernelPool`` have it."""

    def try_step(
        self, x: NDArray[np.float64], u: NDArray[np.float64], d: NDArray[np.float64], p: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], list[StepFailure]]:
        """States ``(n, 28)`` at the end of the step; a row that fails keeps its state and is reported."""


_shared = threading.local()
"""A kernel has working memory of its own, so that each thread gets another one."""


def shared_kernel(step_seconds: float, variant: str) -> Kernel:
    """Kernel of this thread for a step length [s] and a variant of the model; made at the first call."""
    from glbench.kernel import Kernel

    kernels: dict[tuple[float, str], Kernel] = _shared.__dict__.setdefault("kernels", {})
    key = (step_seconds, variant)
    if key not in kernels:
        kernels[key] = Kernel(step_seconds, variant=variant)
    return kernels[key]
