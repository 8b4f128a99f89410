"""What a run draws: its season, its start, its parameters. This is plain data; ``glbench.env`` does the drawing.

All numbers come from counter-based streams (docs/adr/0006, 0014): a number depends on its address alone. Tasks with the same
``family`` and ``salt`` share their numbers, so that they can be compared run by run.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import Literal

Redraw = Literal["step", "day", "episode"]


@dataclass(frozen=True)
class ParameterGroup:
    """Parameters that are drawn together: each is its nominal value times 1 + e.

    Attributes
    ----------
    name
        Name of the group; its stream is called after it.
    parameters
        Their names, in the order in which numbers are drawn.
    distribution, half_width
        Of e.
    redraw
        How often: at every step, at the start of every day, once an episode.
    """

    name: str
    parameters: tuple[str, ...]
    distribution: str
    half_width: float
    redraw: Redraw


@dataclass(frozen=True)
class StartGroup:
    """States whose values at the start are multiplied by factors 1 + e, one a state and run."""

    name: str
    states: tuple[str, ...]
    distribution: str
    half_width: float


@dataclass(frozen=True)
class Season:
    """A weather record, and the first day of an episode in it."""

    source: str
    start: dt.date


@dataclass(frozen=True)
class Generated:
    """Seasons from the weather generator.

    Attributes
    ----------
    years
        Years of the record that they are made of.
    seasons
        How many there are. The run with a seed is in season (seed - first_seed) modulo this number.
    first_seed
        Seed of the run in season 0.
    co2_range
        Lowest and highest CO2 outside [ppm], between which it wanders; ``None`` where it stays.
    """

    years: tuple[int, ...]
    seasons: int
    first_seed: int
    co2_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Scenario:
    """What a run draws.

    Attributes
    ----------
    family, salt
        Tasks that agree in both share their random numbers.
    groups, start_groups
        Parameters, and states at the start, that are drawn.
    seasons
        A run draws one of these evenly. Of generated seasons, the calendar.
    start_within_days
        A run's first day is drawn evenly from the season's first day to this many days later. The first days of generated seasons are
        spread evenly over these days.
    generated
        Where seasons are generated: of what. Their weather and first days belong to the season's number, not to the seed.
    legacy
        Schema 1: streams are keyed by task id and seed, as they always were.
    """

    family: str
    salt: str
    groups: tuple[ParameterGroup, ...]
    start_groups: tuple[StartGroup, ...]
    seasons: tuple[Season, ...]
    start_within_days: int = 0
    generated: Generated | None = None
    legacy: bool = False
