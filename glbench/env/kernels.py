"""What steps the model for an environment: a preset's name, a kernel of one's own, or the kernel that environments share."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from glbench.errors import GlbenchError, UnknownNameError, did_you_mean
from glbench.kernel.sundials import PRESETS

if TYPE_CHECKING:
    from glbench.kernel import Kernel, StepFailure
    from glbench.tasks import TaskSpec

SCORING_PRESET = "reference"
"""What scores are made with, and the default."""


class Stepper(Protocol):
    """What a simulation needs of a kernel; ``glbench.kernel.Kernel`` and ``KernelPool`` have it."""

    def try_step(
        self, x: NDArray[np.float64], u: NDArray[np.float64], d: NDArray[np.float64], p: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], list[StepFailure]]:
        """States ``(n, 28)`` at the end of the step; a row that fails keeps its state and is reported."""


_shared = threading.local()
"""A kernel has working memory of its own, so that each thread gets another one."""


def shared_kernel(step_seconds: float, variant: str, preset: str = SCORING_PRESET) -> Kernel:
    """Kernel of this thread for a step length [s], a variant of the model and a preset; made at the first call."""
    from glbench.kernel import Kernel

    kernels: dict[tuple[float, str, str], Kernel] = _shared.__dict__.setdefault("kernels", {})
    key = (step_seconds, variant, preset)
    if key not in kernels:
        kernels[key] = Kernel(step_seconds, variant=variant, preset=preset)
    return kernels[key]


def check_kernel(kernel: object, task: TaskSpec) -> None:
    """Refuse what cannot step ``task``.

    Raises
    ------
    UnknownNameError
        For a name that is no preset, with the nearest one.
    GlbenchError
        For a kernel of another step length or model variant than the task's, and for what is no kernel at all.
    """
    if kernel is None:
        return
    if isinstance(kernel, str):
        if kernel not in PRESETS:
            msg = f"There is no kernel preset '{kernel}'.{did_you_mean(kernel, PRESETS)}"
            raise UnknownNameError(msg)
        return
    if isinstance(kernel, type) or not callable(getattr(kernel, "try_step", None)):
        presets = ", ".join(f"'{name}'" for name in PRESETS)
        msg = f"The kernel is the name of a preset ({presets}) or a Kernel, such as Kernel({task.step_seconds:g}); got {kernel!r}."
        raise GlbenchError(msg)
    for name, wanted in (("step_seconds", task.step_seconds), ("variant", task.model.variant)):
        found = getattr(kernel, name, wanted)
        if found != wanted:
            msg = f"The kernel has {name} = {found!r}, but {task.id} needs {wanted!r}. Make the kernel for the task, or give its preset."
            raise GlbenchError(msg)
