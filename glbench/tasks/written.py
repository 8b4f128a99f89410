"""A task's tables as its file writes them, got back from the task or from a record of it."""

from __future__ import annotations

import copy
import datetime as dt
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from glbench.errors import TaskError
from glbench.tasks.tables import TaskFile1

if TYPE_CHECKING:
    from glbench.tasks.spec import TaskSpec

_UNITS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "initial_state": {"air_temperature": "degC"},
        "prices": {
            "fruit": "EUR kg-1", "dry_matter_content": "kg kg-1", "co2": "EUR kg-1", "heat": "EUR kWh-1", "electricity": "EUR kWh-1",
        },
        "penalty_scale": {"air_temperature": "degC", "co2": "ppm", "relative_humidity": "%"},
        "failed_step": {"epi": "EUR m-2"},
        "time_limits": {"start": "s", "step": "s", "run": "s"},
    }
)  # fmt: skip
"""Keys of schema 1 that a file writes with their unit and a task holds as plain numbers."""


def tables_of(task: TaskSpec) -> dict[str, Any]:
    """The tables that define ``task``, as TOML gives them.

    Raises
    ------
    TaskError
        When the task is an unchecked copy of schema 2, of which there are none.
    """
    if isinstance(task.file, TaskFile1):
        plain = task.file.model_dump(mode="json", by_alias=True)
        plain["model"]["overrides"] = {name: [value, unit] for name, value, unit in task.model.overrides}
        return with_dates(tables_of_schema_1(plain))
    if task.file._written is None:
        msg = f"{task.source} is a changed copy of a task, which nothing checked. Make it with replace, or write it as a file."
        raise TaskError(msg)
    return copy.deepcopy(dict(task.file._written))


def tables_of_schema_1(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values of a task of schema 1, overrides as pairs of value and unit, as a file writes them: numbers with their units.

    Raises
    ------
    KeyError, TypeError, ValueError, AttributeError
        When the values define no task.
    """
    written = {key: dict(value) if isinstance(value, Mapping) else value for key, value in plain.items()}
    written["model"]["overrides"] = {
        name: {"value": value, "unit": unit} for name, (value, unit) in plain["model"]["overrides"].items()
    }
    for table, owner in (
        ("initial_state", written),
        ("prices", written),
        ("penalty_scale", written["reward"]),
        ("failed_step", written["evaluation"]),
        ("time_limits", written["evaluation"]),
    ):
        units = _UNITS[table]
        if owner.get(table) is None:  # a task that limits no time
            owner.pop(table, None)
            continue
        owner[table] = {
            key: {"value": value, "unit": units[key]} if key in units else value for key, value in owner[table].items()
        }
    written["observation"] = {key: value for key, value in written["observation"].items() if value is not None}
    return written


def with_dates(tables: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of ``tables`` in which the days and moments of a task are what TOML makes of them, wherever they are text (ISO 8601)."""
    copied: dict[str, Any] = copy.deepcopy(dict(tables))
    for table, key, read in _moments(copied):
        if isinstance(table, dict) and isinstance(table.get(key), str):
            try:
                table[key] = read(table[key])
            except ValueError:
                continue  # what a day or a moment must look like, the check of the tables says
    return copied


def _moments(tables: Mapping[str, Any]) -> Iterator[tuple[Any, str, Callable[[str], dt.date]]]:
    """Every place of a day or a moment: its table, its key, and what reads it."""

    def inside(table: object, key: str) -> Any:
        return table.get(key) if isinstance(table, Mapping) else None

    def entries(found: object) -> list[Any]:
        return found if isinstance(found, list) else []

    day, moment = dt.date.fromisoformat, dt.datetime.fromisoformat
    yield inside(tables, "weather"), "start", day
    for season in entries(inside(tables.get("scenario"), "seasons")):
        yield season, "start", day
    prices = tables.get("price_tables")
    for table in prices.values() if isinstance(prices, Mapping) else ():
        for point in entries(inside(table, "series")):
            yield point, "time", moment
