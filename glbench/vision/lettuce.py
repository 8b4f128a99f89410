"""A bed of butterhead lettuce as triangles, from the mean mass of its heads.

A head is a rosette: leaves follow each other at the golden angle. Old leaves lie outside, flat and round; from about 60 g on the inner
ones bend over each other and close a pale heart. Where neighbours meet, outer leaves rise.

Chosen, after photographs and these figures: leaf number 5 at 3 g, 13 at 30 g, 35 at 300 g; width of a free plant 6 cm at 3 g, 13 cm at
30 g and 27 cm at 300 g, which is the mass to the power 0.32 (a third would be one shape at all sizes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glbench.arrays import Floats
from glbench.vision.mesh import GOLDEN_ANGLE, Mesh, draws, joined, of_grids, smooth

PLANTS = 25.0
"""Plants per floor area [m-2], as in the lettuce tasks."""
VARIATION_OF_HEADS = 0.10
"""Coefficient of variation of the mass of the heads in a planting, as in ``LettuceHarvest-v1``."""
ACROSS = 5
"""Heads of a bed in each direction. The camera sees the middle ones."""
_ALONG, _ASIDE = 11, 9
"""Points of a leaf along and across."""
_BED, _HEAD = 1, 2
"""Streams of draws: what a planting shares, and what each head has of its own."""


@dataclass(frozen=True)
class Habit:
    """How the plants of one planting differ from the mean at equal mass."""

    width: float
    """Width of a plant, relative."""
    heart: float
    """Width of the heart, relative."""
    slender: float
    """Width of a leaf over its length, relative."""
    wave: float
    """Waves of the margin, relative."""
    yellow: float
    """Colour: -1 dark green to 1 yellow, about."""

    @classmethod
    def of(cls, variation: int) -> Habit:
        """Habit of the plant variation with that number. Chosen: 4 % of the width, which is about 12 % of mass at equal width."""
        width, heart, slender, wave, yellow = draws(_BED, variation).normal(size=5).clip(-2.0, 2.0)
        return cls(np.exp(0.04 * width), np.exp(0.05 * heart), np.exp(0.06 * slender), np.exp(0.25 * wave), 0.5 * yellow)


def bed(mass: float, variation: int, plants: float = PLANTS, cv_head: float = VARIATION_OF_HEADS) -> tuple[Mesh, Floats]:
    """Leaves of a bed, and the mass of each head [g], shape (25,).

    ``mass`` is the mean fresh mass of the planting's heads [g], ``plants`` per floor area [m-2], ``cv_head`` their coefficient of
    variation. A variation has the same plants at every mass. The bed is centred on (0, 0, 0).
    """
    habit, spacing = Habit.of(variation), plants**-0.5
    places = (np.arange(ACROSS) - (ACROSS - 1) / 2) * spacing
    heads, masses = [], []
    for number, (x, y) in enumerate((x, y) for x in places for y in places):
        own = draws(_HEAD, variation, number)
        masses.append(mass * (1.0 + cv_head * float(np.clip(own.normal(), -2.5, 2.5))))
        leaves = head(masses[-1], habit, own, spacing)
        heads.append(Mesh(leaves.vertices + np.append(own.normal(size=2) * 0.005 + [x, y], 0.0), leaves.triangles, leaves.colours))
    return joined(heads), np.array(masses)


def head(mass: float, habit: Habit, own: np.random.Generator, spacing: float) -> Mesh:
    """Leaves of one head of fresh ``mass`` [g], its stem at (0, 0, 0), among neighbours ``spacing`` apart [m]."""
    number = 3.2 * mass**0.42
    rank = np.arange(60)
    noise = own.normal(size=(6, 60)).clip(-2.0, 2.0)[:, rank < number]
    turn = own.uniform(0.0, 2.0 * np.pi) + rank[rank < number] * GOLDEN_ANGLE + 0.10 * noise[0]
    age = (number - rank[rank < number]) / number  # 1: the oldest leaf, 0: one that appears
    closed = smooth(np.log(mass), np.log(40.0), np.log(220.0)) * smooth(1.0 - age, 0.30, 0.55)  # 1: a leaf of the heart
    reach = 0.0215 * mass**0.32 * habit.width  # radius of a free plant [m]
    crowded = smooth(reach / spacing, 0.35, 0.95)

    heart = 0.0092 * mass ** (1 / 3) * habit.heart * (0.62 + 0.60 * age)  # radius of the dome that a leaf follows [m]
    open_length = reach * (0.25 + 0.85 * age**0.6 - 0.10 * age**4) * (1.0 + 0.06 * noise[1])
    length = (1.0 - closed) * open_length + closed * heart * 3.35 * (1.0 + 0.03 * noise[1])
    first = np.radians((1.0 - closed) * (72.0 - 50.0 * age + 26.0 * crowded * age) + closed * 4.0 + 4.0 * noise[2])
    last = np.radians((1.0 - closed) * (58.0 - 85.0 * age + 45.0 * crowded * age) + closed * 198.0 + (9.0 - 3.0 * closed) * noise[3])
    half = habit.slender * ((1.0 - closed) * length * (0.50 + 0.05 * noise[4]) + closed * heart * (1.25 + 0.08 * noise[4]))

    u = np.linspace(0.0, 1.0, _ALONG)[None, :, None] ** 0.85
    v = np.linspace(-1.0, 1.0, _ASIDE)[None, None, :]
    turn, age, closed, length, first, last, half, heart = (
        array[:, None, None] for array in (turn, age, closed, length, first, last, half, heart)
    )
    broadest = 0.60 + 0.16 * closed
    outline = np.where(
        u < broadest, 0.30 + 0.70 * smooth(u, 0.0, broadest), np.sqrt(np.clip(1.0 - ((u - broadest) / (1.0 - broadest)) ** 2, 0.0, 1.0))
    )
    across = half * outline * v  # [m] from the midrib
    slope = first + (last - first) * u  # of the midrib [rad]: 0 outwards, pi / 2 up
    step = length * np.diff(u, axis=1, prepend=0.0)
    outwards, up = np.cumsum(step * np.cos(slope), axis=1) + 0.006, np.cumsum(step * np.sin(slope), axis=1) + 0.004
    phase = 2.0 * np.pi * own.random((len(age), 4, 1))[:, :, :, None]
    wave = habit.wave * (1.0 - 0.75 * closed) * length * 0.060 * np.abs(v) ** 2.5 * smooth(u, 0.2, 0.7)
    ripple = wave * np.sin(2.0 * np.pi * 2.3 * u * np.sign(v) + phase[:, 0]) + 0.4 * wave * np.sin(2.0 * np.pi * 5.0 * u + phase[:, 1])
    blister = 0.015 * length * np.sin(13.0 * u + phase[:, 2]) * np.cos(7.0 * v + phase[:, 3]) * np.abs(v) * (1.0 - np.abs(v)) * 4.0
    bend = closed / heart + (1.0 - closed) * (0.9 - 0.5 * age) / length  # across the leaf, towards its upper side [m-1]
    lift = (1.0 - np.cos(np.clip(bend * across, -1.5, 1.5))) / bend + ripple + blister
    aside = np.sin(np.clip(bend * across, -1.5, 1.5)) / bend
    radius, height = outwards - np.sin(slope) * lift, up + np.cos(slope) * lift
    points = np.stack([radius * np.cos(turn) - aside * np.sin(turn), radius * np.sin(turn) + aside * np.cos(turn), height], axis=-1)
    return of_grids(points, _colours(u, v, age, closed, habit, noise[5]))


def _colours(u: Floats, v: Floats, age: Floats, closed: Floats, habit: Habit, noise: Floats) -> Floats:
    """Reflectance of leaves, shape (leaves, along, across, 3): green outside, pale yellow in the heart, ribs paler than blades."""
    old, young, pale = np.array([0.085, 0.225, 0.028]), np.array([0.24, 0.42, 0.07]), np.array([0.50, 0.60, 0.20])
    share = np.clip(1.0 - age + 0.12 * habit.yellow, 0.0, 1.0)[..., None]
    blade = (1.0 - share) * old + share * young
    heart = closed[..., None] * smooth(1.0 - age, 0.35, 1.0)[..., None]
    blade = (1.0 - heart) * blade + heart * pale
    rib = 0.55 * np.exp(-((v / 0.09) ** 2)) * (1.0 - 0.75 * u)
    vein = 0.10 * np.cos(2.0 * np.pi * (4.5 * u - 1.6 * np.abs(v))) * smooth(np.abs(v), 0.0, 0.2)
    shade = 1.0 + 0.10 * noise[:, None, None] + vein
    rib = np.broadcast_to(rib, shade.shape)[..., None]
    colours: Floats = (1.0 - rib) * blade * shade[..., None] + rib * np.array([0.50, 0.58, 0.28])
    return colours
