"""Fills the tables of docs/measured-data.md from what the reader knows: ``python -m docs.measured_columns``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from docs.tables import with_tables
from glbench.realism.export import UNIT_FACTORS, WEATHER_UNITS
from glbench.realism.indoor import INDOOR, REQUIRED_OF_EXPORT
from glbench.resources import write_atomically
from glbench.weather.column_map import UNITS

PAGE = Path(__file__).with_name("measured-data.md")
WEATHER: Mapping[str, str] = {
    "global_radiation": "global radiation",
    "outdoor_temperature": "outdoor air temperature",
    "outdoor_humidity": "outdoor relative humidity",
    "wind_speed": "wind speed",
    "sky_temperature": "apparent sky temperature; estimated where there is none",
}


def tables() -> dict[str, str]:
    """Rows of the indoor climate and of the weather."""
    inside = ["| column | units | meaning | possible values | needed |", "|---|---|---|---|---|"]
    for name, quantity in INDOOR.items():
        units = [*UNIT_FACTORS[quantity.unit], *(["%"] if name == "lamps" else [])]
        needed = "yes" if name in REQUIRED_OF_EXPORT else ""
        inside.append(
            f"| `{name}` | {', '.join(units)} | {quantity.meaning} | {quantity.low:g} to {quantity.high:g} {quantity.unit} | {needed} |"
        )
    outside = ["| column | units | meaning | needed |", "|---|---|---|---|"]
    for name, unit in WEATHER_UNITS.items():
        units = [*(UNITS[name] if name == "global_radiation" else UNIT_FACTORS[unit])]
        outside.append(f"| `{name}` | {', '.join(units)} | {WEATHER[name]} | {'' if name == 'sky_temperature' else 'yes'} |")
    return {"indoor": "\n".join(inside), "weather": "\n".join(outside)}


def filled(page: str) -> str:
    """The page with its tables."""
    return with_tables(page, tables())


if __name__ == "__main__":
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8")))
