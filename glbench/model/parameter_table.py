"""The table of the parameters: unit, meaning, source, and the values of the named sets. It is stored in parameters.csv."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal, TypeAlias

from glbench.model.parameters import Parameters
from glbench.model.quantities import public_name

Check: TypeAlias = Literal["fraction", "positive", "nonnegative", "negative", "any"]
"""What values a parameter may have: 0 to 1, above 0, at least 0, below 0, any finite number."""

BENCHMARK = "benchmark"
"""Name of the set that every other set refines."""

TABLE_FILE = Path(__file__).with_name("parameters.csv")


@dataclass(frozen=True)
class ParameterInfo:
    """One row of the table of parameters.

    Attributes
    ----------
    name, attribute
        Public name (``aCov``) and name in the equations (``a_cov``).
    unit, meaning, source
        In words.
    group
        Part of the greenhouse it belongs to: ``physics``, ``house``, ``roof``, ``lamps``, ``crop``, ...
    check
        What values are possible.
    formula
        How a derived entry follows from others; empty for a base entry.
    used
        ``yes``: the equations read it; ``derived``: only through derived entries; ``inactive``: multiplied by a control
        that this model keeps at 0; ``no``: not read.
    values
        Value in each named set; a set without an entry has that of the benchmark. Empty for a derived entry.
    """

    name: str
    attribute: str
    unit: str
    meaning: str
    source: str
    group: str
    check: Check
    formula: str
    used: Literal["yes", "derived", "inactive", "no"]
    in_crop28: bool
    in_crop34: bool
    values: MappingProxyType[str, float] = field(repr=False)

    @property
    def is_derived(self) -> bool:
        """Whether the value follows from other parameters."""
        return bool(self.formula)


SETS_IN_TABLE: tuple[str, ...] = (BENCHMARK, "hps_2020", "led_2020", "hps_2021", "led_2021")


def read_table(path: Path = TABLE_FILE) -> tuple[ParameterInfo, ...]:
    """Table of parameters, in the order of the vector."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    table = []
    for attribute in Parameters._fields:
        row = rows[public_name(attribute)]
        table.append(
            ParameterInfo(
                name=row["name"],
                attribute=attribute,
                unit=row["unit"],
                meaning=row["description"],
                source=row["source"],
                group=row["group"],
                check=row["check"],  # type: ignore[arg-type]
                formula=row["formula"],
                used=row["used"],  # type: ignore[arg-type]
                in_crop28=row["crop28"] == "1",
                in_crop34=row["crop34"] == "1",
                values=MappingProxyType({name: float(row[name]) for name in SETS_IN_TABLE if row[name]}),
            )
        )
    return tuple(table)


PARAMETERS: tuple[ParameterInfo, ...] = read_table()
"""Name, unit, meaning, source and values of every parameter, in the order of the vector."""

PARAMETER_NAMES: tuple[str, ...] = tuple(info.name for info in PARAMETERS)
