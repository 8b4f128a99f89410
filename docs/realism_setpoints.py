"""How far docs/realism-tables.md depends on the set points that it assumes: ``python -m docs.realism_setpoints FOLDER [--only-page]``.

Simulates the measured season (``FOLDER`` as for ``glbench validate``) again under pages of settings that differ in one set point, and
writes season sums, means over the compartments, into docs/measurements/realism-setpoints.json and the table into the page. The file
holds no measured row. ``--only-page`` fills the table from it, without the archive.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docs.tables import with_tables
from glbench.errors import GlbenchError
from glbench.realism import Archive, HouseComparison, Settings, choose_houses, compare, read_archive, read_settings
from glbench.resources import write_atomically

DOCS = Path(__file__).parent
PAGE, FIGURES = DOCS / "realism-tables.md", DOCS / "measurements" / "realism-setpoints.json"
MARK = "setpoints"
HOUSE = "mixed_2020"
"""The published set with both kinds of lamps. All compartments are driven by the page, also one that has set points of its own."""
log = logging.getLogger("setpoints")


@dataclass(frozen=True)
class Change:
    """A page of settings that differs: what is added to some of its entries, by heading, and ``warmer`` of ``glbench validate``."""

    words: str
    warmer: float = 0.0
    added: Mapping[str, Mapping[str, float]] | None = None

    def of(self, settings: Settings) -> Settings:
        """The page with the change."""
        content = settings.model_dump()
        for heading, entries in (self.added or {}).items():
            for entry, more in entries.items():
                content[heading][entry] += more
        return Settings.model_validate(content)


def _all(heading: str, more: float, *entries: str) -> Mapping[str, Mapping[str, float]]:
    return {heading: dict.fromkeys(entries, more)}


ASSUMED = "as_assumed"
CHANGES: Mapping[str, Change] = {
    ASSUMED: Change("as assumed"),
    "colder": Change("heating and vents 1 K lower", warmer=-1.0),
    "warmer": Change("heating and vents 1 K higher", warmer=1.0),
    "vents_earlier": Change("vents open 1 K earlier", added=_all("ventilation", -1.0, "day", "night")),
    "vents_later": Change("vents open 1 K later", added=_all("ventilation", 1.0, "day", "night")),
    "more_humid": Change("humidity deficit 0.5 g m⁻³ lower", added=_all("humidity_deficit", -0.5, "day", "night")),
    "drier": Change("humidity deficit 0.5 g m⁻³ higher", added=_all("humidity_deficit", 0.5, "day", "night")),
}
"""By name. 0.5 g m-3 are about 3 % relative humidity at 19 degC."""


def measured(archive: Archive, settings: Settings) -> dict[str, Any]:
    """Sums of the season under each change, means over the compartments."""
    houses, found = choose_houses((HOUSE,)), dict[str, Any]()
    for name, change in CHANGES.items():
        comparison, _ = compare(archive, houses, change.of(settings), warmer=change.warmer)
        found[name] = _sums(comparison.houses[0])
        log.info("%s: %s", change.words, found[name])
    return {"digest": comparison.digest, "house": HOUSE, "settings": settings.model_dump(), "changes": found}


def _sums(house: HouseComparison) -> dict[str, float]:
    """Heat [MJ m-2] and its ratio to what was measured, RMSE of a day [MJ m-2 d-1], fruit [kg m-2], mean air temperature [degC]."""
    return {
        "heat": round(house.mean(lambda one: one.heat.simulated), 2),
        "heat_ratio": round(house.heat_ratio, 4),
        "heat_rmse": round(house.heat_rmse, 4),
        "fruit": round(house.mean(lambda one: one.harvest.simulated), 3),
        "air_temperature": round(house.mean(lambda one: one.air_temperature), 3),
    }


def table(found: Mapping[str, Any]) -> str:
    """A row for each change."""
    lines = [
        "| set points | heat, MJ m⁻² | change | simulated / measured | RMSE a day | fruit, kg m⁻² | change | mean air temperature, °C |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, sums in found["changes"].items():
        heat, fruit = ("" if name == ASSUMED else f"{change(found, name, what):+.0f} %" for what in ("heat", "fruit"))
        lines.append(
            f"| {CHANGES[name].words} | {sums['heat']:.0f} | {heat} | {sums['heat_ratio']:.2f} | {sums['heat_rmse']:.2f} | "
            f"{sums['fruit']:.1f} | {fruit} | {sums['air_temperature']:.1f} |"
        )
    return "\n".join(lines)


def change(found: Mapping[str, Any], name: str, what: str) -> float:
    """By how much ``heat`` or ``fruit`` changes [%]."""
    return 100.0 * (float(found["changes"][name][what]) / float(found["changes"][ASSUMED][what]) - 1.0)


def read() -> dict[str, Any]:
    """What is stored."""
    content: dict[str, Any] = json.loads(FIGURES.read_text(encoding="utf-8"))
    return content


def filled(page: str, found: Mapping[str, Any]) -> str:
    """The page with its table."""
    return with_tables(page, {MARK: table(found)})


def main() -> None:
    """Simulate, write, fill the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", help="the unpacked archive")
    parser.add_argument("--only-page", action="store_true", help="fill the table from what is stored")
    asked = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    if not asked.only_page:
        if asked.folder is None:
            parser.error("name the folder of the archive, or give --only-page")
        try:
            found = measured(read_archive(asked.folder), read_settings())
        except GlbenchError as error:
            parser.error(str(error))
        write_atomically(FIGURES, json.dumps(found, indent=1) + "\n")
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8"), read()))


if __name__ == "__main__":
    main()
