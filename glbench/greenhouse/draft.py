"""Parameters of a greenhouse while they are worked out: values, how each follows from the page, and what the page leaves to the book."""

from __future__ import annotations

from typing import NamedTuple

from glbench.model import TOMATO

SCREEN_BELOW_GUTTER = 0.2  # Screens hang so far below the gutter [m]. As in the book's greenhouse of 2021, whose gutter is at 6.5 m.
SPAN = 4.0  # Width of one span of a Venlo roof [m]
PIPE_WALL = 0.002  # Thickness of a pipe's wall [m]. The book's pipes of 51 mm have a bore of 47 mm.
_ABSORBED = 0.02  # Share of the light that a cover or screen absorbs at least [-]


class Entry(NamedTuple):
    """A parameter: name, value, unit, and how the value follows from the page."""

    name: str
    value: float
    unit: str
    reason: str


class Supply(NamedTuple):
    """What is installed [W] or [mg s-1]: of the whole greenhouse or, with ``of_floor``, of each square metre; and the page's own words."""

    amount: float
    of_floor: bool
    words: str

    def total(self, floor: float) -> float:
        """Of a whole greenhouse with so much floor [m2]."""
        return self.amount * floor if self.of_floor else self.amount


class Draft:
    """A greenhouse of ``floor`` [m2]; what a page does not say has the value of the named set ``book_name``.

    ``entries`` are its parameters, ``assumptions`` what was taken from elsewhere, ``refusals`` what cannot be.
    """

    def __init__(self, floor: float, book_name: str) -> None:
        self.floor, self.book_name = floor, book_name
        vector = TOMATO.parameters.default(book_name)
        self.book: dict[str, float] = dict(zip(TOMATO.parameter_names, vector.tolist(), strict=True))
        self.entries: dict[str, Entry] = {}
        self.assumptions: list[str] = []
        self.refusals: list[str] = []

    def add(self, name: str, value: float, reason: str) -> None:
        """Set a parameter; one that equals the book's is left to the book."""
        if value != self.book[name]:
            self.entries[name] = Entry(name, float(f"{value:.9g}"), TOMATO.parameters.info(name).unit, reason)

    def add_layer(self, layer: str, light: float, reason: str) -> None:
        """Set the light that a cover or screen lets through [-]; it reflects no more than is left of the rest."""
        for band in ("Par", "Nir"):
            self.add(f"tau{layer}{band}", light, reason)
            reflected = min(self.book[f"rho{layer}{band}"], max(1.0 - _ABSORBED - light, 0.0))
            self.add(f"rho{layer}{band}", reflected, f"what the light leaves, at most {self.book[f'rho{layer}{band}']:g} of the book")

    def add_supply(self, name: str, supply: Supply | None, entry: str, factor: float, unit: str) -> None:
        """Set what is installed of the whole greenhouse; ``factor`` leads from the parameter's unit to ``unit``, of the floor."""
        of_floor = self.book[name] / self.book["aFlr"]
        if supply is None:
            self.value_or(None, factor * of_floor, entry, unit)
            supply = Supply(of_floor, True, f"{factor * of_floor:.4g} {unit} of the book")
        total = supply.total(self.floor)
        self.add(name, total, f"{supply.words}, {factor * total / self.floor:.4g} {unit} on {self.floor:,.0f} m2")

    def value_or(self, value: float | None, instead: float, entry: str, unit: str, reason: str = "") -> float:
        """The page's value, or the one that is assumed ``instead``, which goes onto the list of assumptions."""
        if value is not None:
            return value
        number = 100.0 * instead if unit.startswith("%") else instead
        self.assumptions.append(f"{entry}: {number:.4g} {unit} ({reason or f'the book {self.book_name}'})")
        return instead
