"""What the fields of task tables have in common: the base of the tables, units, known words, lists and texts."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from glbench.errors import did_you_mean, refuse
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
            refuse(f"low = {self.low:g} must be below high = {self.high:g}.")
        return self


def in_unit(unit: str) -> BeforeValidator:
    """Read ``{ value = ..., unit = "..." }`` and hand on the value, if the unit is ``unit``."""

    def number(entry: object) -> object:
        if not isinstance(entry, Mapping) or set(entry) != {"value", "unit"}:
            refuse(f'Write it with its unit: {{ value = ..., unit = "{unit}" }}.')
        if entry["unit"] != unit:
            refuse(f'Its unit is "{unit}", not {as_written(entry["unit"])}: convert the value and write that unit.')
        return entry["value"]

    return BeforeValidator(number)


def price_in(unit: str) -> BeforeValidator:
    """Read a price above 0 in ``unit``, or one for each side: ``{ low = ..., high = ..., unit = "..." }``, which becomes a pair."""
    number = in_unit(unit).func

    def price(entry: object) -> object:
        sides = ("low", "high") if isinstance(entry, Mapping) and "value" not in entry else ("value",)
        if not isinstance(entry, Mapping) or set(entry) != {*sides, "unit"}:
            refuse(f'Write it with its unit: {{ value = ..., unit = "{unit}" }}, or {{ low = ..., high = ..., unit = "{unit}" }}.')
        prices = tuple(number({"value": entry[side], "unit": entry["unit"]}) for side in sides)  # type: ignore[call-arg]
        if not all(isinstance(one, int | float) and not isinstance(one, bool) and one > 0.0 for one in prices):
            refuse("It must be a price above 0.")
        return prices[0] if len({*prices}) == 1 else tuple(map(float, prices))

    return BeforeValidator(price)


def limits_in(unit: str) -> BeforeValidator:
    """Refuse limits that state another unit than ``unit``."""

    def limits(table: object) -> object:
        if isinstance(table, Mapping) and table.get("unit", unit) != unit:
            refuse(f'Its unit is "{unit}", not {as_written(table["unit"])}: convert low and high and write that unit.')
        return table

    return BeforeValidator(limits)


def one_of(registry: Registry[Any]) -> BeforeValidator:
    """Accept a word of the registry; refuse any other with the nearest."""

    def word(name: object) -> str:
        if not isinstance(name, str):
            refuse(f"It must be the name of a {registry.kind}, in quotes.")
        if name not in registry:
            refuse(f"There is no {registry.kind} called '{name}'.{did_you_mean(name, registry.names)}")
        return name

    return BeforeValidator(word)


def list_of(kind: str, example: str, registry: Registry[Any] | None = None) -> BeforeValidator:
    """Accept a list of different names, at least one; words of the registry if there is one."""

    def names(entries: object) -> tuple[str, ...]:
        if not isinstance(entries, list | tuple) or not entries or not all(isinstance(name, str) for name in entries):
            refuse(f'It must be a list of names of {kind}s, such as ["{example}"].')
        for name in entries:
            if registry is not None and name not in registry:
                refuse(f"There is no {kind} called '{name}'.{did_you_mean(name, registry.names)}")
            if entries.count(name) > 1:
                refuse(f"'{name}' is listed twice.")
        return tuple(entries)

    return BeforeValidator(names)


def as_tuple(value: object) -> object:
    """A list of TOML as a tuple."""
    return tuple(value) if isinstance(value, list) else value


def sorted_overrides(table: object) -> tuple[Override, ...]:
    """``[model.overrides]`` or ``[initial_state.controls]``: names with value and unit, in the order of their names."""
    if not isinstance(table, Mapping):
        refuse('It must be a table with lines such as hAir = { value = 5.7, unit = "m" }.')
    overrides = []
    for name, entry in sorted(table.items()):
        if not isinstance(entry, Mapping) or set(entry) != {"value", "unit"} or not isinstance(entry["unit"], str):
            refuse(f'Write {name} with its unit: {name} = {{ value = ..., unit = "..." }}.')
        if isinstance(entry["value"], bool) or not isinstance(entry["value"], int | float):
            refuse(f"The value of {name} is {as_written(entry['value'])}, which is not a number.")
        overrides.append((name, float(entry["value"]), entry["unit"]))
    return tuple(overrides)


def set_or_list(value: object) -> str | tuple[str, ...]:
    """The name of a parameter set, or a list of different parameters."""
    if isinstance(value, str) and value:
        return value
    if not isinstance(value, list | tuple) or not value or not all(isinstance(name, str) for name in value):
        refuse('It must be the name of a set, such as "crop28", or a list of parameters, such as ["sla", "rgFruit"].')
    if len(set(value)) < len(value):
        refuse("A parameter is listed twice.")
    return tuple(value)


def check_hours(hours: tuple[int, ...], longest: int) -> None:
    """Refuse hours ahead that do not rise, or are beyond ``longest``."""
    if any(not 1 <= hour <= longest for hour in hours) or any(later <= earlier for earlier, later in pairwise(hours)):
        refuse(f"hours = {list(hours)} must be different whole hours from 1 to {longest}, the nearest first.")


def printable(value: object) -> object:
    """Text for terminals and pages; characters that steer them are refused."""
    for letter in value if isinstance(value, str) else "":
        if not (letter.isprintable() or letter in "\n\t" or unicodedata.category(letter) == "Zs"):
            refuse(f"It holds the character U+{ord(letter):04X}, which cannot be shown. Take it out.")
    return value


def one_line(value: object) -> object:
    """Printable text of one line."""
    if isinstance(value, str) and len(value.splitlines()) > 1:
        refuse("It must be one line.")
    return printable(value)


def suite_names(value: object) -> tuple[str, ...]:
    """A list of names of suites."""
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) and name for name in value):
        refuse('It must be a list of names, such as ["paper"].')
    return tuple(str(one_line(name)) for name in value)
