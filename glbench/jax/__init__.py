"""glbench's environments for JAX: stepped by the compiled kernel from inside ``jit``, ``scan`` and ``vmap``.

``Environment(task)`` has the signature of gymnax. See docs/jax.md.
"""

from __future__ import annotations

from glbench.errors import GlbenchError

try:
    import jax as _jax  # noqa: F401  # the error below is clearer than the one deep inside
except ImportError as error:
    _msg = (
        'glbench.jax needs JAX, which is not installed. Install it with `pip install "glbench[jax]"`, or in a checkout with '
        "`uv sync --inexact --extra jax`."
    )
    raise GlbenchError(_msg) from error

from glbench.jax.environment import Environment, Params, State
from glbench.jax.spaces import Box

__all__ = ["Box", "Environment", "Params", "State"]
