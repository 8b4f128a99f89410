"""Spreads: how far the parameters of houses lie apart, in ``spreads.csv``. A task names one in place of parameters and half width.

A parameter's draw is its nominal value times exp(log_sd factor z), z bell-shaped with mean 0 and standard deviation 1, kept between ``low``
and ``high``; parameters of one ``draw`` share z. ``heat_elasticity`` is d ln(heat of a season) / d ln(parameter): a house whose heat, by
these, is outside ``HEAT`` times the nominal house's is drawn again. Made by ``python -m docs.spread_measured``; see docs/uncertainty.md.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

from glbench.errors import did_you_mean, refuse

SPREADS_FILE = Path(__file__).with_name("spreads.csv")
HEAT = (0.5, 1.5)
"""A season's heat, as predicted, relative to that of the nominal house: lowest and highest."""
ATTEMPTS = 32
"""How often a house is drawn before the last one is moved towards the nominal house until its heat is within ``HEAT``."""
LARGEST_FACTOR = 2.0
_FARTHEST = 3.0  # |z| of a bell-shaped number (glbench.env.random)


class SpreadRow(NamedTuple):
    """A line of the file: ``log_sd`` of the logarithm at the factor 1, ``low`` and ``high`` relative to the nominal value."""

    parameter: str
    draw: str
    log_sd: float
    low: float
    high: float
    heat_elasticity: float


@dataclass(frozen=True)
class Spread:
    """A spread and the factor by which a task scales its logarithms."""

    name: str
    factor: float
    rows: tuple[SpreadRow, ...]

    def limits(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest multiplier that each parameter can have."""
        farthest = [math.exp(_FARTHEST * self.factor * row.log_sd) for row in self.rows]
        return {row.parameter: (max(row.low, 1.0 / far), min(row.high, far)) for row, far in zip(self.rows, farthest, strict=True)}

    def reach(self) -> dict[str, str]:
        """The same in words."""
        return {name: f"{low:.2g} to {high:.3g} times" for name, (low, high) in self.limits().items()}

    @property
    def width(self) -> float:
        """Largest relative deviation of a parameter from its nominal value."""
        return max(high - 1.0 for _, high in self.limits().values())


@cache
def read_spread(name: str, factor: float = 1.0) -> Spread:
    """The spread of that name; ``ValueError`` when there is none."""
    with SPREADS_FILE.open(newline="", encoding="utf-8") as file:
        _, *lines = csv.reader(file)
    rows = tuple(SpreadRow(parameter, draw, *map(float, numbers)) for of, parameter, draw, *numbers in lines if of == name)
    if not rows:
        names = dict.fromkeys(line[0] for line in lines)
        refuse(f"There is no spread called '{name}'.{did_you_mean(name, names, list_few=False)} There is: {', '.join(names)}.")
    return Spread(name, factor, rows)
