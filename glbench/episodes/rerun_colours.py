"""Colours of the controllers: the palette of Okabe and Ito (2008), which eyes of every kind tell apart."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Colour:
    """A colour with its name in words and its red, green and blue (0 to 255)."""

    name: str
    rgb: tuple[int, int, int]


PALETTE: tuple[Colour, ...] = (
    Colour("orange", (230, 159, 0)),
    Colour("sky blue", (86, 180, 233)),
    Colour("bluish green", (0, 158, 115)),
    Colour("reddish purple", (204, 121, 167)),
    Colour("yellow", (240, 228, 66)),
    Colour("vermilion", (213, 94, 0)),
)
"""In the order in which controllers get them. Black is left out, and blue: they drown in the viewer's dark plots."""

WEATHER = Colour("light grey", (190, 190, 190))
LIMITS = Colour("green", (96, 176, 96))
