"""The viewer's package, which is an optional part of glbench."""

from __future__ import annotations

import importlib
from typing import Any

from glbench.errors import GlbenchError


def load_rerun() -> Any:
    """The module ``rerun``.

    Raises
    ------
    GlbenchError
        When it is not installed; it says how to install it.
    """
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        msg = (
            "The viewer is not installed: it needs the package rerun-sdk. "
            'Install it with `pip install "glbench[view]"`, or in a checkout with `uv sync --extra view`.'
        )
        raise GlbenchError(msg) from error


def load_blueprint() -> Any:
    """The module ``rerun.blueprint``; raises as ``load_rerun`` does."""
    load_rerun()
    return importlib.import_module("rerun.blueprint")
