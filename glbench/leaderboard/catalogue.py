"""What tables, the terminal and the report call things: metrics, what is sold and bought, controls, limits and recorded columns.

This module and ``catalogue.toml`` are the only places above the tasks that name any of them; everything else is handed this catalogue
and goes by kinds. The words are in the file, units and order come from the evaluation. A metric that is not in here is shown by its name.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

from glbench.evaluation.metrics import METRICS

Kind = Literal["score", "profit", "penalty", "earned", "paid", "amount", "violation", "outside", "unknown"]
_DIGITS = {"EUR m-2": 3, "kWh m-2": 2, "kg m-2": 3, "h": 1}
_FEW_DIGITS = 2


@dataclass(frozen=True)
class Metric:
    """A metric: its unit in result files, and how it is shown; ``catalogue.toml`` explains the fields."""

    name: str
    unit: str
    kind: Kind
    label: str
    decimals: int
    line: str
    better: Literal["high", "low"]
    explanation: str
    heading: str = ""
    digits: int = 2
    interval: bool = False

    @property
    def column(self) -> bool:
        """Whether it is a column of the leaderboard."""
        return bool(self.heading)

    @property
    def headed(self) -> str:
        """Heading with unit, as in ``Heat [kWh/m²]``."""
        unit = pretty_unit(self.unit)
        return f"{self.heading} [{unit}]" if unit else self.heading

    def text(self, value: float) -> str:
        """A value with the decimals that its unit deserves."""
        return f"{value:,.{_DIGITS.get(self.unit, _FEW_DIGITS)}f}"


@dataclass(frozen=True)
class Item:
    """What is sold (``sign`` 1) or bought (-1), and where it stands: as a price of the task, money, amount, and column of profiles."""

    price: str
    money: str
    amount: str
    column: str
    sign: int
    label: str
    short: str
    words: str
    unit: str
    colour: int
    least: float = 0.0


@dataclass(frozen=True)
class Catalogue:
    """All of it. ``charts`` and ``panels`` say which recorded columns the report draws, and where."""

    metrics: Mapping[str, Metric]
    items: tuple[Item, ...]
    limits: Mapping[str, str]
    controls: Mapping[str, str]
    series: tuple[Mapping[str, Any], ...]
    charts: Mapping[str, tuple[str, ...]]
    panels: tuple[Mapping[str, Any], ...]

    def known_first(self, names: Iterable[str]) -> list[str]:
        """All metrics of this version in their order, then those among ``names`` that it does not know."""
        return [*self.metrics, *(name for name in dict.fromkeys(names) if name not in self.metrics)]

    def metric(self, name: str, units: Mapping[str, str]) -> Metric:
        """A metric; one that is unknown here by its name, with its unit in ``units``."""
        return self.metrics.get(name) or unknown_metric(name, units.get(name, "-"))

    @property
    def score(self) -> Metric:
        """What ranks where no task says otherwise."""
        return self.of_kind("score")[0]

    @property
    def profit(self) -> Metric:
        """What is earned minus what is paid."""
        return self.of_kind("profit")[0]

    @property
    def headlines(self) -> list[Metric]:
        """Columns that are shown with their intervals."""
        return [metric for metric in self.metrics.values() if metric.column and metric.interval]

    def of_kind(self, *kinds: Kind) -> list[Metric]:
        """The metrics of these kinds, in their order."""
        return [metric for metric in self.metrics.values() if metric.kind in kinds]


@cache
def catalogue() -> Catalogue:
    """The catalogue of the greenhouse and its tomatoes."""
    text = (resources.files("glbench.leaderboard") / "catalogue.toml").read_text(encoding="utf-8")
    told = tomllib.loads(text)
    words = {entry.pop("name"): entry for entry in told["metric"]}
    units = {metric.name: metric.unit for metric in METRICS}
    return Catalogue(
        metrics={
            name: Metric(name, unit, **words[name]) if name in words else unknown_metric(name, unit)
            for name, unit in units.items()
        },
        items=tuple(Item(**entry) for entry in told["item"]),
        limits={entry["name"]: entry["label"] for entry in told["limit"]},
        controls={entry["name"]: entry["label"] for entry in told["control"]},
        series=tuple(told["series"]),
        charts={name: tuple(columns) for name, columns in told["charts"].items()},
        panels=tuple(told["panel"]),
    )


def unknown_metric(name: str, unit: str) -> Metric:
    """A metric without words: it is called by its name."""
    return Metric(name, unit, "unknown", name, _FEW_DIGITS, name, "high", "")


def pretty_unit(unit: str) -> str:
    """A unit as people write it: ``EUR/m²`` for ``EUR m-2``; empty for none."""
    text = re.sub(
        r" (\w+?)-(\d)", lambda match: f"/{match[1]}{'' if match[2] == '1' else '²' if match[2] == '2' else '³'}", unit
    )
    return {"-": "", "degC": "°C"}.get(text, text)
