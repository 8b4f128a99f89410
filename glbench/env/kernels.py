"""Kernels of environments: one of a preset, which the environments of a thread share, or a custom kernel."""

from __future__ import annotations

import threading
from typing import Protocol

from glbench.arrays import Floats
from glbench.errors import GlbenchError, UnknownNameError, did_you_mean, refuse
from glbench.kernel import Kernel, StepFailure
from glbench.model import Model
from glbench.tasks import TaskSpec

SCORING_PRESET = "reference"
"""The preset of scores, and the default."""


class Stepper(Protocol):
    """The method of a kernel that a simulation calls; ``glbench.kernel.Kernel`` has it."""

    def try_step(self, x: Floats, u: Floats, d: Floats, p: Floats) -> tuple[Floats, list[StepFailure]]:
        """States ``(n, states)`` at the end of the step; a row that fails keeps its state and is reported."""


_shared = threading.local()
"""One kernel a thread, because a kernel has working memory."""


def shared_kernel(model: Model, step_seconds: float, preset: str = SCORING_PRESET) -> Kernel:
    """Kernel of this thread for a model, a step length [s] and a preset; made at the first call."""
    kernels: dict[tuple[Model, float, str], Kernel] = _shared.__dict__.setdefault("kernels", {})
    key = (model, step_seconds, preset)
    if key not in kernels:
        kernels[key] = Kernel(model, step_seconds, preset=preset)
    return kernels[key]


def check_kernel(kernel: object, task: TaskSpec) -> None:
    """Refuse what cannot step ``task``.

    Raises ``UnknownNameError`` for a name that is no preset, with the nearest one. Raises ``GlbenchError`` for a kernel of another step
    length or model than the task's, or an object that is no kernel.
    """
    if kernel is None:
        return
    if isinstance(kernel, str | type) or not callable(getattr(kernel, "try_step", None)):
        from glbench.kernel.cvodes import PRESETS

        if isinstance(kernel, str):
            if kernel in PRESETS:
                return
            refuse(f"There is no kernel preset '{kernel}'.{did_you_mean(kernel, PRESETS)}", UnknownNameError)
        presets = ", ".join(f"'{name}'" for name in PRESETS)
        example = f"Kernel(task.model_value, {task.step_seconds:g})"
        refuse(f"The kernel is the name of a preset ({presets}) or a Kernel, such as {example}; got {kernel!r}.", GlbenchError)
    model = task.model_value
    own = getattr(kernel, "model", model)
    for name, value, expected in (
        ("step_seconds", getattr(kernel, "step_seconds", task.step_seconds), task.step_seconds),
        ("model", own.id, model.id),
        ("variant", own.variant, model.variant),
    ):
        if value != expected:
            msg = f"The kernel has {name} = {value!r}, but {task.id} needs {expected!r}. Make the kernel for the task, or give its preset."
            raise GlbenchError(msg)
