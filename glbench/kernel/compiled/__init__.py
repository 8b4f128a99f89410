"""The compiled backend of the kernel: the model as generated C++, stepped by Rosenbrock methods in SIMD lanes.

``CompiledStepper(TOMATO, 900.0).step_rows(x, u, d, p, out)`` steps a batch in place; ``availability()`` says in words why it cannot
be used here, if so. How it works, how accurate and how fast it is: docs/kernel-compiled.md.
"""

from glbench.kernel.compiled.binding import Failure, failed_with
from glbench.kernel.compiled.compiler import CompiledUnavailable
from glbench.kernel.compiled.library import absent_equipment
from glbench.kernel.compiled.stepper import PRESETS, CompiledStepper, Preset, availability

__all__ = ["PRESETS", "CompiledStepper", "CompiledUnavailable", "Failure", "Preset", "absent_equipment", "availability", "failed_with"]
