"""The reference: the model as the benchmark's paper steps it.

CasADi's interface to CVODES with absolute and relative tolerance 1e-6 on the states as they are, the right-hand side compiled by
the C compiler at -O3. Without a compiler CasADi's virtual machine evaluates it, which is told.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glbench.kernel.compiled.accuracy import make_cvodes
from glbench.speed.clock import Work
from glbench.speed.workloads import Course, Points

TOLERANCE = 1e-6
_STEPS = 96


@dataclass(frozen=True)
class Reference:
    """CVODES for one step length; ``compiled`` says whether the model is."""

    integrator: Any
    compiled: bool

    def scattered(self, points: Points) -> Work:
        """Some of the steps of ``points``, one by one."""
        held = np.concatenate([points.u, points.d], axis=1)[:_STEPS]
        states = points.x[:_STEPS]

        def work() -> int:
            for x, inputs in zip(states, held, strict=True):
                self.integrator(x0=x, p=inputs)
            return len(held)

        return work

    def course(self, course: Course) -> Work:
        """All steps of ``course``, each from where the one before ended."""
        held = np.concatenate([course.controls, course.weather], axis=1)

        def work() -> int:
            x = course.start
            for inputs in held:
                x = self.integrator(x0=x, p=inputs)["xf"]
            return len(held)

        return work


@contextmanager
def references(step_lengths: tuple[float, ...]) -> Iterator[dict[float, Reference]]:
    """A reference for each step length [s]. CasADi compiles in the working directory, which is elsewhere meanwhile."""
    compiled = shutil.which("gcc") is not None
    before = Path.cwd()
    with tempfile.TemporaryDirectory(prefix="glbench-bench-") as folder:
        os.chdir(folder)
        try:
            yield {
                seconds: Reference(make_cvodes(TOLERANCE, seconds, jit=compiled), compiled) for seconds in step_lengths
            }
        finally:
            os.chdir(before)
