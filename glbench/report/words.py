"""Every metric and every word of the page in a grower's words; the texts are in ``assets/words.toml``."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Literal


@dataclass(frozen=True)
class MetricWords:
    """How a metric is shown: heading, unit as people write it, decimals, one line of explanation, which way is better.

    ``column`` is true for columns of the leaderboard, ``interval`` for those whose 95 % interval is drawn as a bar.
    """

    name: str
    label: str
    unit: str
    decimals: int
    explanation: str
    better: Literal["high", "low"]
    column: bool
    interval: bool


@dataclass(frozen=True)
class Words:
    """``metrics`` with those of the leaderboard's columns first, in its order; ``others`` as pairs of a word and its meaning."""

    metrics: tuple[MetricWords, ...]
    others: tuple[tuple[str, str], ...]


@cache
def words() -> Words:
    """All words of the page."""
    text = (resources.files("glbench.report") / "assets" / "words.toml").read_text(encoding="utf-8")
    document = tomllib.loads(text)
    return Words(
        metrics=tuple(MetricWords(**entry) for entry in document["metric"]),
        others=tuple((entry["word"], entry["meaning"]) for entry in document["word"]),
    )
