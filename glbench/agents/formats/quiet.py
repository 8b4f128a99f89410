"""Warnings of other libraries about themselves, which tell the person at the terminal nothing that they could act upon."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Keep what is warned of while a file is loaded to itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
