"""What the fields of task tables have in common: the base of the tables, units, known words, lists and texts."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from glbench.errors import did_you_mean
from glbench.tasks.inheritance import as_written
from glbench.tasks.ledger import LIMITED
from glbench.tasks.vocabulary import Registry

Override = tuple[str, float, str]
"""Name of a parameter, its value, and the unit of the value."""


class Table(BaseModel):
    """Base of the tables: frozen, strict, no unknown keys, no NaN and no infinity."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False, validate_by_name=False)


class ClimateQuantityTable(Table):
    """A table with an entry for quantities of the indoor air that a task can limit."""

    def items(self) -> tuple[tuple[str, Any], ...]:
        """Names and entries of those that the table has: air temperature, CO2, relative humidity."""
        entries = ((name, getattr(self, name)) for name in LIMITED)
        return tuple((name, entry) for name, entry in entries if entry is not None)


class Limits(Table):
    """Lowest and highest value allowed, in ``unit``."""

    low: float = Field(description="a number")
    high: float = Field(description="a number")
    unit: str = Field(description="the unit in quotes")

    @model_validator(mode="after")
    def _low_is_below_high(self) -> Self:
        if self.low >= self.high:
            msg = f"low = {self.low:g} must be below high = {self.high:g}."
            raise ValueError(msg)
        return self


def in_unit(unit: str) -> BeforeValidator:
    """Read ``{ value = ..., unit = "..." }`` and hand on the value, if the unit is ``unit``."""

    def number(entry: object) -> object:
        if not isinstance(entry, Mapping) or set(entry) != {"value", "unit"}:
            msg = f'Write it with its unit: {{ value = ..., unit = "{unit}" }}.'
            raise ValueError(msg)
        if entry["unit"] != unit:
            msg = f'Its unit is "{unit}", not {as_written(entry["unit"])}: convert the value and write that unit.'
            raise ValueError(msg)
        return entry["value"]

    return BeforeValidator(number)


def limits_in(unit: str) -> BeforeValidator:
    """Refuse limits that state another unit than ``unit``."""

    def limits(table: object) -> object:
        if isinstance(table, Mapping) and table.get("unit", unit) != unit:
            msg = f'Its unit is "{unit}", not {as_written(table["unit"])}: convert low and high and write that unit.'
            raise ValueError(msg)
        return table

    return BeforeValidator(limits)


def one_of(registry: Registry[Any]) -> BeforeValidator:
    """Accept a word of the registry; refuse any other with the nearest."""

    def word(name: object) -> str:
        if not isinstance(name, str):
            msg = f"It must be the name of a {registry.kind}, in quotes."
            raise ValueError(msg)  # noqa: TRY004 -- pydantic turns ValueErrors into messages, TypeErrors into crashes
        if name not in registry:
            msg = f"There is no {registry.kind} called '{name}'.{did_you_mean(name, registry.names)}"
            raise ValueError(msg)
        return name

    return BeforeValidator(word)


def list_of(kind: str, example: str, registry: Registry[Any] | None = None) -> BeforeValidator:
    """Accept a list of different names, at least one; words of the registry if there is one."""

    def names(entries: object) -> tuple[str, ...]:
        if not isinstance(entries, list | tuple) or not entries or not all(isinstance(name, str) for name in entries):
            msg = f'It must be a list of names of {kind}s, such as ["{example}"].'
            raise ValueError(msg)
        for name in entries:
            if registry is not None and name not in registry:
                msg = f"There is no {kind} called '{name}'.{did_you_mean(name, registry.names)}"
                raise ValueError(msg)
            if entries.count(name) > 1:
                msg = f"'{name}' is listed twice."
                raise ValueError(msg)
        return tuple(entries)

    return BeforeValidator(names)


def as_tuple(value: object) -> object:
    """A list of TOML as a tuple."""
    return tuple(value) if isinstance(value, list) else value


def sorted_overrides(table: object) -> tuple[Override, ...]:
    """``[model.overrides]``: parameters with value and unit, in the order of their names."""
    if not isinstance(table, Mapping):
        msg = 'It must be a table: [model.overrides] with lines such as hAir = { value = 5.7, unit = "m" }.'
        raise ValueError(msg)  # noqa: TRY004 -- see one_of
    overrides = []
    for name, entry in sorted(table.items()):
        if not isinstance(entry, Mapping) or set(entry) != {"value", "unit"} or not isinstance(entry["unit"], str):
            msg = f'Write {name} with its unit: {name} = {{ value = ..., unit = "..." }}.'
            raise ValueError(msg)
        if isinstance(entry["value"], bool) or not isinstance(entry["value"], int | float):
            msg = f"The value of {name} is {as_written(entry['value'])}, which is not a number."
            raise ValueError(msg)  # noqa: TRY004 -- see one_of
        overrides.append((name, float(entry["value"]), entry["unit"]))
    return tuple(overrides)


def set_or_list(value: object) -> str | tuple[str, ...]:
    """The name of a parameter set, or a list of different parameters."""
    if isinstance(value, str) and value:
        return value
    if isinstance(value, list | tuple) and value and all(isinstance(name, str) for name in value):
        if len(set(value)) < len(value):
            msg = "A parameter is listed twice."
            raise ValueError(msg)
        return tuple(value)
    msg = 'It must be the name of a set, such as "crop28", or a list of parameters, such as ["sla", "rgFruit"].'
    raise ValueError(msg)


def check_hours(hours: tuple[int, ...], longest: int) -> None:
    """Refuse hours ahead that do not rise, or are beyond ``longest``."""
    if any(not 1 <= hour <= longest for hour in hours) or any(later <= earlier for earlier, later in pairwise(hours)):
        msg = f"hours = {list(hours)} must be different whole hours from 1 to {longest}, the nearest first."
        raise ValueError(msg)


def printable(value: object) -> object:
    """Text for terminals and pages; characters that steer them are refused."""
    for letter in value if isinstance(value, str) else "":
        if not (letter.isprintable() or letter in "\n\t" or unicodedata.category(letter) == "Zs"):
            msg = f"It holds the character U+{ord(letter):04X}, which cannot be shown. Take it out."
            raise ValueError(msg)
    return value


def one_line(value: object) -> object:
    """Printable text of one line."""
    if isinstance(value, str) and len(value.splitlines()) > 1:
        msg = "It must be one line."
        raise ValueError(msg)
    return printable(value)


def suite_names(value: object) -> tuple[str, ...]:
    """A list of names of suites."""
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) and name for name in value):
        msg = 'It must be a list of names, such as ["paper"].'
        raise ValueError(msg)
    return tuple(str(one_line(name)) for name in value)
