"""The packages that only the report needs, which are an optional part of glbench."""

from __future__ import annotations

import importlib
from typing import Any

from glbench.errors import GlbenchError


def _load(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        msg = (
            f"The report cannot be made: it needs the package {name.partition('.')[0]}. "
            'Install it with `pip install "glbench[report]"`, or in a checkout with `uv sync --extra report`.'
        )
        raise GlbenchError(msg) from error


def load_jinja() -> Any:
    """The module ``jinja2``.

    Raises
    ------
    GlbenchError
        When it is not installed; it says how to install it.
    """
    return _load("jinja2")


def plotly_script() -> bytes:
    """The script plotly.js as the package plotly carries it; raises as ``load_jinja`` does."""
    script: str = _load("plotly.offline").get_plotlyjs()
    return script.encode()
