"""Which kernel stepped the model for a result: two builds of one preset are two kernels."""

from __future__ import annotations

import hashlib
import json

from glbench.evaluation import Result

_SHORT = 6


def kernel_label(result: Result) -> str:
    """What stepped the model: ``backend/preset``."""
    kernel = result.evaluation.kernel
    return "/".join(str(kernel[key]) for key in ("backend", "preset") if key in kernel)


def kernel_build(result: Result) -> str:
    """A short name for everything that makes the kernel: its library, and a digest of method, settings, compiler and flags.

    The name begins like the ``library_digest`` in the result file, so that one finds the other.
    """
    kernel = result.evaluation.kernel
    everything = hashlib.sha256(json.dumps(kernel, sort_keys=True).encode()).hexdigest()
    return f"{str(kernel.get('library_digest', everything))[:_SHORT]}.{everything[:_SHORT]}"
