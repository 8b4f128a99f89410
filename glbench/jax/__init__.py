"""glbench's environments for JAX: stepped by the compiled kernel from inside ``jit``, ``scan`` and ``vmap``.

``Environment(task)`` gives the five values a step of gymnax before 1.0, which PureJaxRL and rejax 0.1.3 unpack;
``GymnaxEnvironment(task)`` is an environment of gymnax 1.x. See docs/jax.md.
"""

from typing import TYPE_CHECKING

from glbench.errors import GlbenchError
from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.jax.gymnax import GymnaxEnvironment as GymnaxEnvironment

try:
    import jax as _jax  # noqa: F401  # the error below is clearer than the one deep inside
except ImportError as error:
    _msg = (
        'glbench.jax needs JAX, which is not installed. Install it with `pip install "glbench[jax]"`, or in a checkout with '
        "`uv sync --inexact --extra jax`."
    )
    raise GlbenchError(_msg) from error

from glbench.jax.environment import Box, Environment, Params, State

if not TYPE_CHECKING:
    __getattr__ = lazy_names(__name__, {"gymnax": ("GymnaxEnvironment",)})  # needs gymnax, which the others do not

__all__ = ["Box", "Environment", "Params", "State"]
