"""The catalogue of quantities: name, unit, meaning, label, digits, colour and direction of everything that glbench itself names.

``quantities.toml`` defines each once and explains its keys; all code that shows, stores or explains a quantity reads it
here. A model declares its own states, controls and flows with its equations, and a task declares its own items in its
ledger: their units, meanings and labels are the ones given there. ``docs/extending.md`` shows how to add a quantity.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

Words = Mapping[str, Any]  # Texts for one use of a quantity, by key; ``quantities.toml`` explains the keys


@dataclass(frozen=True)
class Entry:
    """One quantity; ``quantities.toml`` explains the fields. Fields that do not apply are empty."""

    name: str
    unit: str = "-"
    meaning: str = ""
    label: str = ""
    words: str = ""
    low: float = 0.0
    high: float = 0.0
    at_end: str = ""
    observed: str = ""
    below: Words = field(default_factory=dict)
    above: Words = field(default_factory=dict)
    day: str = ""
    day_unit: str = ""
    day_factor: float = 1.0
    summed: str = ""
    priced: Words = field(default_factory=dict)
    page: str = ""
    metric: Words = field(default_factory=dict)
    chart: Words = field(default_factory=dict)
    short: str = ""
    colour: int | None = None
    least: float = 0.0
    column: str = ""
    ledger_label: str = ""
    amount_label: str = ""
    price_of: str = ""
    gas: str = ""
    money: Words = field(default_factory=dict)
    amount: Words = field(default_factory=dict)

    @property
    def item_label(self) -> str:
        """The label of a ledger item that has none of its own."""
        return self.ledger_label or self.label

    @property
    def charted(self) -> str:
        """The column of profiles that its chart shows."""
        return self.column or self.name.removesuffix(_TODAY)


_TODAY = "_today"


_FILE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
GROUPS: Mapping[str, Mapping[str, Entry]] = MappingProxyType(
    {group: MappingProxyType({name: Entry(name, **words) for name, words in entries.items()}) for group, entries in _FILE.items()}
)
"""All entries by group and name, in the order of the file."""
CLOCK, AIR, DEFICITS = GROUPS["clock"], GROUPS["air"], GROUPS["deficit"]
INSIDE, LIGHT, OUTDOOR = GROUPS["inside"], GROUPS["light"], GROUPS["outdoor"]
STEP, RUN, FLOWS = GROUPS["step"], GROUPS["run"], GROUPS["flow"]

MONEY = STEP["epi"].unit  # Unit of all amounts of money
VIOLATION, OUTSIDE = "violation_", "hours_outside_"
"""Prefixes of the quantities of a step that say how far, and for how long, a quantity of the air was beyond a limit. The name of the
limited quantity follows, then ``_low`` or ``_high``.
"""


def known_flow(flow: str, label: str) -> Entry | None:
    """The entry of a flow that a ledger prices under ``label``; ``None`` if the flow is unknown or the ledger has its own label."""
    entry = FLOWS.get(flow)
    if entry is None or label.replace("CO2", "CO₂") not in ("", entry.label, entry.item_label, entry.amount_label):
        return None
    return entry


def charts() -> dict[str, dict[str, Any]]:
    """Texts of all charts by column of profiles, in the form that the report uses."""
    return {
        entry.charted: {
            "name": entry.charted,
            "label": entry.label,
            "unit": pretty_unit(entry.unit),
            **({"gas": entry.gas} if entry.gas else {}),
            **entry.chart,
        }
        for entries in GROUPS.values()
        for entry in entries.values()
        if entry.chart
    }


def unit_sold(amount_unit: str) -> str:
    """What a price is for: ``kg`` where amounts are in kg m-2; empty where they are counted."""
    return amount_unit.removesuffix("m-2").strip(" -")


def pretty_unit(unit: str) -> str:
    """A unit as people write it: ``EUR/m²`` for ``EUR m-2``; empty for none."""
    text = re.sub(r"(?:^| )(\w+?)-(\d)", lambda match: f"/{match[1]}{'' if match[2] == '1' else '²' if match[2] == '2' else '³'}", unit)
    return {"-": "", "degC": "°C"}.get(text, text)


_PLAIN, _RAISED = "0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"


def raised_unit(unit: str) -> str:
    """``kg m⁻²`` for ``kg m-2``."""
    raised = str.maketrans(_PLAIN, _RAISED)
    return re.sub(r"-?\d+", lambda number: number[0].translate(raised), unit.replace("degC", "°C"))


def plain_unit(unit: str) -> str:
    """``kg m-2`` for ``kg m⁻²``."""
    return unit.translate(str.maketrans(_RAISED, _PLAIN))


def in_sentence(label: str) -> str:
    """A label inside a sentence: ``heat`` for ``Heat``; ``CO₂`` stays."""
    return label if label[1:2].isupper() else label[:1].lower() + label[1:]


def capitalised(name: str) -> str:
    """A name as a label: ``Fruit picked`` for ``fruit_picked``."""
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:]


def sentence(words: Sequence[str]) -> str:
    """``heat, light and CO2``."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
