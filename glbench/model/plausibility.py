"""Figures of a greenhouse that a grower would doubt: parameters by the square metre of floor, against what is built.

Nothing here is forbidden. A figure beyond its possible range mostly has another unit than the parameter: kW taken for W, the
boiler of a hectare on 144 m2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

_GRAMS_AN_HOUR = 3.6
"""From mg s-1."""


class Doubt(NamedTuple):
    """A figure beyond its usual range, in words, and whether it is beyond what is possible."""

    text: str
    impossible: bool


class Figure(NamedTuple):
    """A figure that follows from parameters p; ``usual`` and ``possible`` are its lowest and highest values [``unit``]."""

    name: str
    unit: str
    usual: tuple[float, float]
    possible: tuple[float, float]
    value: Callable[[Mapping[str, float]], float]
    parameters: str
    advice: str = ""


FIGURES = (
    Figure(
        "Floor area", " m2", (60.0, 1e6), (1.0, 1e7), lambda p: p["aFlr"], "aFlr",
        "A hectare is 10,000 m2. A point is the decimal sign: 50.000 is fifty.",
    ),
    Figure(
        "Boiler", " W for each m2 of floor", (20.0, 400.0), (0.0, 1000.0), lambda p: p["pBoil"] / p["aFlr"], "pBoil aFlr",
        "pBoil is in W for the whole floor aFlr, in m2: 1 MW is 1,000,000 W.",
    ),
    Figure(
        "CO2 supply", " g m-2 h-1", (5.0, 45.0), (0.0, 200.0), lambda p: _GRAMS_AN_HOUR * p["phiExtCo2"] / p["aFlr"], "phiExtCo2 aFlr",
        "phiExtCo2 is in mg s-1 for the whole floor aFlr, in m2: 1 kg/h is 277.8 mg s-1, and 100 kg/ha/h are 10 g m-2 h-1.",
    ),
    Figure(
        "Lamps", " W for each m2 of floor", (10.0, 250.0), (0.0, 1000.0), lambda p: p["thetaLampMax"], "thetaLampMax",
        "thetaLampMax is electric power in W m-2, not light in umol m-2 s-1.",
    ),
    Figure(
        "Lamp light", " umol m-2 s-1", (20.0, 600.0), (0.0, 2500.0),
        lambda p: p["thetaLampMax"] * p["etaLampPar"] * p["zetaLampPar"], "thetaLampMax etaLampPar zetaLampPar",
    ),
    Figure(
        "Efficacy of the lamps", " umol J-1", (1.0, 4.2), (0.3, 5.6),
        lambda p: p["etaLampPar"] * p["zetaLampPar"], "thetaLampMax etaLampPar zetaLampPar",
        "High-pressure sodium lamps have 1.6 to 1.9, LEDs 2.5 to 4. Are light and power swapped?",
    ),
    Figure("Cover", " m2 for each m2 of floor", (1.0, 3.0), (0.98, 10.0), lambda p: p["aCov"] / p["aFlr"], "aCov aFlr"),
    Figure("Slope of the roof", " deg", (5.0, 45.0), (0.0, 80.0), lambda p: p["psi"], "psi"),
    Figure("Mean height", " m", (2.5, 12.0), (1.0, 50.0), lambda p: p["hGh"], "hGh", "Heights are in m, not in cm."),
    Figure("Height of the air below the screens", " m", (2.0, 10.0), (0.5, 50.0), lambda p: p["hAir"], "hAir"),
    Figure("Height of the air above the screens", " m", (0.1, 3.0), (0.01, 20.0), lambda p: p["hGh"] - p["hAir"], "hGh hAir"),
    Figure("Roof vents", " m2 for each m2 of floor", (0.03, 0.6), (0.0, 1.0), lambda p: p["aRoof"] / p["aFlr"], "aRoof aFlr"),
    Figure("Height of a vent opening", " m", (0.2, 3.0), (0.01, 10.0), lambda p: p["hVent"], "hVent"),
    Figure("Light that the roof lets through", "", (0.4, 0.95), (0.02, 0.98), lambda p: p["tauRfPar"], "tauRfPar"),
    Figure(
        "Diameter of the rail pipes", " m", (0.02, 0.12), (0.005, 0.5), lambda p: p["phiPipeE"], "phiPipeE",
        "It is in m: 51 mm are 0.051 m.",
    ),
    Figure(
        "Bore of the rail pipes", " of their outer diameter", (0.7, 0.99), (0.01, 0.999),
        lambda p: p["phiPipeI"] / p["phiPipeE"], "phiPipeI phiPipeE",
    ),
    Figure("Rail pipes", " m for each m2 of floor", (0.3, 6.0), (0.01, 30.0), lambda p: p["lPipe"], "lPipe"),
)  # fmt: skip
"""What is looked at. Usual ranges are wide: production greenhouses of any climate, research compartments, and the books' houses."""
_SUPPLIES = ("pBoil", "phiExtCo2", "thetaLampMax")
"""Parameters that are 0 in a house without that equipment: figures that begin with them are not looked at there."""


def find_doubts(p: Mapping[str, float]) -> list[Doubt]:
    """What is odd about parameters by name, in the model's units; nothing for a model without such a greenhouse."""
    doubts = []
    for figure in FIGURES:
        names = figure.parameters.split()
        if not p.keys() >= set(names) or p["aFlr"] <= 0.0 or (names[0] in _SUPPLIES and p[names[0]] == 0.0):
            continue
        value = figure.value(p)
        impossible = not figure.possible[0] <= value <= figure.possible[1]
        if figure.usual[0] <= value <= figure.usual[1]:
            continue
        low, high = figure.possible if impossible else figure.usual
        number = f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.4g}"
        sizes = ", ".join(f"{name} = {p[name]:,.10g}" for name in names)
        kind = "possible" if impossible else "usual"
        words = f"{figure.name}: {number}{figure.unit}; the {kind} range is {low:,.10g} to {high:,.10g} ({sizes})."
        doubts.append(Doubt(f"{words}{figure.advice and f' {figure.advice}'}", impossible))
    return doubts
