"""Tables of parameters: unit, meaning, source, and the values of the named sets. That of greenhouse and tomato is parameters.csv."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeAlias, get_type_hints

from glbench.model.quantities import Quantity, public_name

Check: TypeAlias = Literal["fraction", "positive", "nonnegative", "negative", "any"]
"""What values a parameter may have: 0 to 1, above 0, at least 0, below 0, any finite number."""

BENCHMARK = "benchmark"
"""Name of the set that every other set refines."""

DRAWN_SETS = ("crop28", "crop34")
"""Sets of uncertain parameters that a table may have a column for, with 1 in the rows that belong to it."""

TABLE_FILE = Path(__file__).with_name("parameters.csv")


@dataclass(frozen=True)
class ParameterInfo:
    """One row of the table of parameters."""

    name: str
    attribute: str
    """``name`` and ``attribute``: public name (``aCov``) and name in the equations (``a_cov``)."""
    unit: str
    meaning: str
    source: str
    """``unit``, ``meaning`` and ``source``: in words."""
    group: str
    """Part of the greenhouse it belongs to: ``physics``, ``house``, ``roof``, ``lamps``, ``crop``, ..."""
    check: Check
    """What values are possible."""
    formula: str
    """How a derived entry follows from others; empty for a base entry."""
    used: Literal["yes", "always", "derived", "inactive", "no"]
    """``yes``: the equations read it; ``always``: so does the compiled kernel, also where it is 0 in the benchmark's set; ``derived``: only
    through derived entries; ``inactive``: multiplied by a control that this model keeps at 0; ``no``: not read."""
    drawn_in: frozenset[str]
    """Named sets of uncertain parameters that it belongs to: ``crop28``, ``crop34``."""
    values: MappingProxyType[str, float] = field(repr=False)
    """Value in each named set; a set without an entry has that of the benchmark. Empty for a derived entry."""

    @property
    def is_derived(self) -> bool:
        """Whether the value follows from other parameters."""
        return bool(self.formula)


_COLUMNS = frozenset(("name", "unit", "group", "check", "description", "source", "formula", "used"))


def read_table(record: type[Any], path: Path = TABLE_FILE) -> tuple[ParameterInfo, ...]:
    """Rows of the table for the fields of ``record``, in their order.

    The columns after ``used`` are named sets of values, except those that hold only 0 and 1 and are called after a set of uncertain
    parameters: ``crop28``, ``crop34``.
    """
    with path.open(newline="", encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    table = []
    for attribute in record._fields:
        row = rows[public_name(attribute)]
        others = {name: text for name, text in row.items() if name not in _COLUMNS and text}
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
                drawn_in=frozenset(name for name in DRAWN_SETS if others.pop(name, "0") == "1"),
                values=MappingProxyType({name: float(text) for name, text in others.items()}),
            )
        )
    return tuple(table)


@dataclass(frozen=True)
class Parameter(Quantity):
    """Unit and meaning of a parameter, written beside its field, with its value: for submodels without a table in a file.

    ``value`` is that of the benchmark; ``sets`` holds those of other named sets. ``check`` is what values are possible.
    """

    value: float
    source: str = "chosen"
    check: Check = "any"
    group: str = "other"
    sets: tuple[tuple[str, float], ...] = ()


def declared_table(record: type[Any]) -> tuple[ParameterInfo, ...]:
    """Rows for the fields of ``record`` that are annotated with :class:`Parameter`, in their order."""
    return tuple(
        ParameterInfo(
            name=public_name(attribute),
            attribute=attribute,
            unit=note.unit,
            meaning=note.meaning,
            source=note.source,
            group=note.group,
            check=note.check,
            formula="",
            used="always",
            drawn_in=frozenset(),
            values=MappingProxyType({BENCHMARK: note.value, **dict(note.sets)}),
        )
        for attribute, hint in get_type_hints(record, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, Parameter)
    )
