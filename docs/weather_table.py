"""Fills the table of generated seasons in docs/weather.md from the measurements: ``python -m docs.weather_table``.

Each measurement is what ``glbench weather statistics --out FILE`` writes; ``COMMANDS`` says with which options.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from docs.tables import with_tables
from glbench.weather.resemblance import Figure

PAGE = Path(__file__).with_name("weather.md")
MEASUREMENTS = Path(__file__).with_name("measurements") / "weather"
COMMANDS = {
    "training": "--years 2008-2010",
    "again": "--years 2008-2010 --seed 2",
    "test": "--years 2011,2012",
    "short": "--years 2008-2010 --shortest 1 --longest 3",
    "long": "--years 2008-2010 --shortest 8 --longest 16",
    "narrow": "--years 2008-2010 --window 6",
    "wide": "--years 2008-2010 --window 20",
}
HEADINGS = {
    "training": "2008 to 2010",
    "again": "the same, other draws",
    "test": "2011, 2012",
    "short": "blocks of 1 to 3 days",
    "long": "8 to 16 days",
    "narrow": "window ±6 days",
    "wide": "±20 days",
}


def read() -> dict[str, Any]:
    """Measurements by name."""
    return {name: json.loads((MEASUREMENTS / f"{name}.json").read_text(encoding="utf-8")) for name in COMMANDS}


def table(measurements: Mapping[str, Any]) -> str:
    """Every figure of every measurement; those that miss their limits are bold."""
    lines = [f"| | limits | {' | '.join(HEADINGS.values())} |", f"|---|---|{'---|' * len(HEADINGS)}"]
    columns = [[Figure(**figure) for figure in measurements[name]["figures"]] for name in HEADINGS]
    for row in zip(*columns, strict=True):
        cells = [figure.shown if figure.kept else f"**{figure.shown}**" for figure in row]
        lines.append(f"| {row[0].name} | {row[0].limits} | {' | '.join(cells)} |")
    return "\n".join(lines)


def filled(page: str, measurements: Mapping[str, Any]) -> str:
    """The page with its table made of the measurements."""
    return with_tables(page, {"seasons": table(measurements)})


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), read()), encoding="utf-8")
