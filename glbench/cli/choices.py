"""Choices that several commands offer, repeated here so that ``--help`` need not load the evaluation."""

from __future__ import annotations

from enum import StrEnum


class Sandbox(StrEnum):
    """The choices of ``--sandbox``."""

    AUTO = "auto"
    BUBBLEWRAP = "bubblewrap"
    NONE = "none"
