"""Spreads: how far the parameters of houses lie apart, in ``spreads.csv``. A task names one in place of parameters and half width.

A parameter's draw is its nominal value times exp(log_sd factor z), z bell-shaped with mean 0 and standard deviation 1, kept between ``low``
and ``high``; parameters of one ``draw`` share z. ``heat_elasticity`` is d ln(heat of a season) / d ln(parameter): a house whose heat, by
these, is outside ``HEAT`` times the nominal house's is drawn again. Made by ``python -m docs.spread_measured``; docs/uncertainty.md
says what it rests on.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from glbench.errors import did_you_mean, refuse

SPREADS_FILE = Path(__file__).with_name("spreads.csv")
HEAT = (0.5, 1.5)
"""A season's heat, as predicted, relative to that of the nominal house: lowest and highest."""
ATTEMPTS = 32
"""How often a house is drawn before the last one is moved towards the nominal house until its heat is within ``HEAT``."""
LARGEST_FACTOR = 2.0
_FARTHEST = 3.0  # |z| of a bell-shaped number (glbench.env.random)


@dataclass(frozen=True)
class SpreadRow:
    """A line of the file: ``log_sd`` of the logarithm, ``low`` and ``high`` relative to the nominal value, at the factor 1."""

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

    def limits(self, row: SpreadRow) -> tuple[float, float]:
        """Smallest and largest multiplier that a parameter can have."""
        farthest = math.exp(_FARTHEST * self.factor * row.log_sd)
        return max(row.low, 1.0 / farthest), min(row.high, farthest)

    def reach(self) -> dict[str, str]:
        """In words, between which multiples of its nominal value each parameter lies."""
        return {row.parameter: "{:.2g} to {:.3g} times".format(*self.limits(row)) for row in self.rows}

    @property
    def in_words(self) -> str:
        """What is drawn, in sentences."""
        logs = ", ".join(f"{row.parameter} {self.factor * row.log_sd:.2g} ({self.reach()[row.parameter]})" for row in self.rows)
        return (
            f"spread '{self.name}' with factor {self.factor:g}. Each parameter is its nominal value times exp(s z), z with mean 0 and "
            f"standard deviation 1, within limits; s and limits are {logs}. A house that would need less than {HEAT[0]:g} or more than "
            f"{HEAT[1]:g} times the heat of the nominal house in a season is drawn again."
        )

    @property
    def width(self) -> float:
        """Largest relative deviation of a parameter from its nominal value."""
        return max(self.limits(row)[1] - 1.0 for row in self.rows)


@cache
def read_spread(name: str, factor: float = 1.0) -> Spread:
    """The spread of that name.

    Raises
    ------
    ValueError
        When there is none.
    """
    with SPREADS_FILE.open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    rows = tuple(
        SpreadRow(line["parameter"], line["draw"], *(float(line[key]) for key in ("log_sd", "low", "high", "heat_elasticity")))
        for line in lines
        if line["spread"] == name
    )
    if not rows:
        known = dict.fromkeys(line["spread"] for line in lines)
        refuse(f"There is no spread called '{name}'.{did_you_mean(name, known)} There is: {', '.join(known)}.")
    return Spread(name, factor, rows)
