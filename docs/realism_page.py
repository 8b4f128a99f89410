"""Fills the tables of docs/realism.md: ``python -m docs.realism_page``.

Figures: docs/measurements/realism.json and realism-climate.json, which ``glbench validate FOLDER --out`` wrote as comparison.json and
climate.json; bleiswijk-2020.toml, which ``glbench identify FOLDER --page glbench/realism/compartment.toml --split weeks`` wrote as
identified.toml; and compartment-forward-fit.toml, the same with the page compartment-forward.toml and ``--split date:2020-03-01``.
None holds a measured row.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from docs.realism_figure import measured
from docs.tables import with_tables
from glbench.model import COMPARTMENT
from glbench.realism.houses import HOUSES, model, parameters, read_settings

DOCS = Path(__file__).parent
PAGE, MEASUREMENTS = DOCS / "realism.md", DOCS / "measurements"
BOOKS, MEASURED, GROWERS = "mixed_2020", "bleiswijk_2020", "Reference"
CHANNELS = {"air_temperature": ("K", 2), "humidity": ("%", 1), "co2": ("ppm", 0)}


def climate(house: str) -> dict[str, Any]:
    """Errors of a house in the growers' compartment, by actuators."""
    of = json.loads((MEASUREMENTS / "realism-climate.json").read_text(encoding="utf-8"))
    compartment = next(one for one in of["compartments"] if one["name"] == GROWERS)
    return next(one for one in compartment["houses"] if one["name"] == house)


def identified(name: str) -> dict[str, Any]:
    """A page that ``glbench identify`` wrote."""
    return tomllib.loads((MEASUREMENTS / name).read_text(encoding="utf-8"))["identified"]


def summary() -> str:
    """What the page says in short: errors of the climate in odd weeks, heat and fruit of the season."""
    rows = ["| | measured | " + " | ".join(f"`{name}`" for name in (BOOKS, MEASURED)) + " |", "|---|---:|---:|---:|"]
    for channel, (unit, digits) in CHANNELS.items():
        words = {"air_temperature": "air temperature", "humidity": "relative humidity", "co2": "CO2"}[channel]
        cells = [f"{climate(name)['weeks']['odd'][channel]['rmse']:.{digits}f}" for name in (BOOKS, MEASURED)]
        rows.append(f"| {words}, root mean square error, {unit} | | {' | '.join(cells)} |")
    of = {house.name: next(one for one in house.compartments if one.name == GROWERS) for house in measured().houses}
    heat = [f"{of[name].heat.by_pipes:.0f} ({of[name].heat.by_pipes / of[name].heat.measured:.2f})" for name in (BOOKS, MEASURED)]
    rows.append(f"| heat of the pipes in the season, MJ m⁻² | {of[BOOKS].heat.measured:.0f} | {' | '.join(heat)} |")
    fruit = [
        f"{of[name].harvest.simulated:.1f} ({of[name].harvest.simulated / of[name].harvest.measured:.2f})" for name in (BOOKS, MEASURED)
    ]
    rows.append(f"| fruit picked, kg m⁻² | {of[BOOKS].harvest.measured:.1f} | {' | '.join(fruit)} |")
    all_six = [f"{house.harvest_ratio:.2f}" for house in measured().houses if house.name in (BOOKS, MEASURED)]
    return "\n".join([*rows, f"| fruit of all six compartments, simulated / measured | | {' | '.join(all_six)} |"])


def parameter_rows() -> str:
    """Every fitted number: the books' value, that of the set, and its interval from the fit around it."""
    values = COMPARTMENT.parameters
    names, settings = values.names, read_settings()
    book, own = parameters(HOUSES[BOOKS], settings), values.default(MEASURED)
    rows = ["| what | parameter | unit | books | measured | factor | interval |", "|---|---|---|---:|---:|---:|---:|"]
    page = tomllib.loads((DOCS.parent / "glbench" / "realism" / "compartment.toml").read_text(encoding="utf-8"))["parameters"]
    book_names = model(HOUSES[BOOKS].model).parameters.names
    for key, one in identified("bleiswijk-2020.toml")["numbers"].items():
        name = (one.get("multiplies") or one["sets"])[0]
        now, low, high = float(own[names.index(name)]), *one["interval"]
        cells = ["", f"{now:.4g}", "", f"{low:.3g} to {high:.3g}"]
        if name in book_names:
            before = float(book[book_names.index(name)])
            cells = [f"{before:.4g}", f"{now:.4g}", f"{now / before:.2f}", f"{now * low / before:.2f} to {now * high / before:.2f}"]
        elif "multiplies" in one:
            cells[3] = f"{now * low:.3g} to {now * high:.3g}"
        rows.append(f"| {page[key]['meaning'].rstrip('.')} | `{name}` | {values.info(name).unit} | {' | '.join(cells)} |")
    return "\n".join(rows)


def forward() -> str:
    """Errors before and from 1 March, of the fit that saw the days before it alone."""
    rows = ["| fitted before 1 March | air temperature, K | relative humidity, % | CO2, ppm |", "|---|---:|---:|---:|"]
    for part, errors in identified("compartment-forward-fit.toml")["rmse"].items():
        rows.append("| " + " | ".join([part, *(f"{errors[channel]:.{digits}f}" for channel, (_, digits) in CHANNELS.items())]) + " |")
    return "\n".join(rows)


def filled(page: str) -> str:
    """The page with its tables."""
    return with_tables(page, {"summary": summary(), "parameters": parameter_rows(), "forward": forward()})


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
