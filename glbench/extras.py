"""The optional parts of glbench, and what to install for them."""

from __future__ import annotations

from importlib.util import find_spec

from glbench.errors import GlbenchError


def require(what: str, extra: str, *modules: str) -> None:
    """Check, without importing them, that the packages of an optional part of glbench are installed.

    Raises
    ------
    GlbenchError
        When one of them is missing; the message says how to install it.
    """
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        msg = (
            f"{what} needs packages that are not installed ({', '.join(missing)}). "
            f'Install them with `pip install "glbench[{extra}]"`, or in a checkout with `uv sync --inexact --extra {extra}`.'
        )
        raise GlbenchError(msg)
