"""From the tables of a task file to its record, with every mistake in words.

``record_of`` checks the tables of a file. A message names the file, the table, the key, the value and what is allowed; all mistakes of a
file are listed at once. ``changed_tables`` applies changes in Python (``TaskSpec.replace``, the keyword ``overrides`` of the
environments) as a task file does that names the task as its base.
"""

from __future__ import annotations

import contextlib
import copy
import datetime as dt
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from glbench.errors import TaskError, did_you_mean, refuse
from glbench.registration import task_ids
from glbench.settings import Problem, field_of, problems_of, table_at
from glbench.tasks.inheritance import WITHOUT, TaskTables, as_written, check_plain, inherit, take_over_prices
from glbench.tasks.schema1 import PaperTaskFile, TaskFile1, tables_of_attachment
from glbench.tasks.tables import TaskFile2

OWN_NAMESPACE = "my"
"""Namespace of a changed task without an id of its own."""

_NO_NUMBER = ("finite_number", "float_type", "float_parsing")


def schema_of(content: Mapping[str, Any]) -> type[TaskFile1] | type[TaskFile2]:
    """The class that describes the tables of a task file."""
    return TaskFile2 if content.get("schema") == 2 and not isinstance(content["schema"], bool) else TaskFile1


def file_of(content: Mapping[str, Any]) -> TaskFile2:
    """The record of the tables of a task file of either schema. Raises ``pydantic.ValidationError`` when they define no task."""
    kind = schema_of(content)
    return kind.of_content(content) if issubclass(kind, TaskFile2) else PaperTaskFile.of_file(kind.model_validate(content))


def file_of_attachment(plain: Mapping[str, Any]) -> TaskFile2:
    """The record of which ``TaskFile2.attachment`` gave ``plain``. Files are not trusted: they come with records of runs.

    Raises ``pydantic.ValidationError`` or ``KeyError`` or ``TypeError`` or ``ValueError`` or ``AttributeError`` when it defines no task.
    """
    return file_of(with_dates(tables_of_attachment(plain) if plain.get("schema") == 1 else plain))


def record_of(tables: TaskTables, source: str) -> TaskFile2:
    """The record of the tables of a file that messages call ``source``. Raises ``TaskError``, with every mistake, when they define none."""
    try:
        return file_of(tables.content)
    except ValidationError as error:
        root = schema_of(tables.content)
        problems = list(dict.fromkeys(_explain(root, problem) for problem in problems_of(error)))
    name = source if tables.base is None else f"{source} (base {tables.base})"
    if len(problems) == 1:
        msg = f"{name}: {problems[0]}"
    else:
        msg = f"{name} has {len(problems)} mistakes:\n" + "\n".join(f"  - {problem}" for problem in problems)
    raise TaskError(msg) from None


def _explain(root: type[BaseModel], problem: Problem) -> str:
    """One mistake in words."""
    *tables, key = [str(part) for part in problem.place] or ["the file"]
    place = f"[{'.'.join(tables)}] " if tables else ""
    path, kind = [*tables, key], problem.kind
    allowed, is_table = _description(root, path), table_at(root, path) is not None
    if kind == "missing":
        if is_table:
            return f"the table [{'.'.join(path)}] is missing."
        return f"{place}lacks the key '{key}': {allowed or 'it is required'}."
    if kind == "extra_forbidden":
        owner = table_at(root, tables) or root
        keys = [field.alias or name for name, field in owner.model_fields.items()]
        near = did_you_mean(key, keys) or f" Known: {', '.join(keys)}."
        return f"'{key}' is not a key {f'of {place}'.rstrip() if tables else 'or table of a task'}.{near}"
    if kind == "model_type":
        return f"[{'.'.join(path)}] must be a table, not {as_written(problem.value)}."
    if kind == "value_error":
        if is_table:  # or one of several
            return f"[{'.'.join(path)}] {problem.reason}"
        if not problem.place:  # about more than one table: it names them
            return problem.reason
        return f"{place}{key} = {as_written(problem.value)}: {problem.reason}"
    if not allowed:
        return _explain_inside(root, path, problem)
    return f"{place}{key} = {as_written(problem.value)} is not allowed. It must be {allowed}."


def _explain_inside(root: type[BaseModel], parts: list[str], problem: Problem) -> str:
    """A mistake inside the value of a key: which key, where in its list, and what must be there."""
    described = ((place, allowed) for place in range(len(parts) - 1, -1, -1) if (allowed := _description(root, parts[: place + 1])))
    place, allowed = next(described, (0, "what the pages about tasks say"))
    key, inner = parts[place], [one for one in parts[place + 1 :] if one not in ("float", "str")]
    if inner and key == "hourly":
        inner[0] = f"hour {inner[0]}"
    elif inner and inner[0].isdecimal():
        inner[0] = f"entry {inner[0]}"
    table = f"[{'.'.join(parts[:place])}] " if place else ""
    number = " a finite number" if problem.kind in _NO_NUMBER and inner else ""
    rule = f"It must be{number}: {key} is {allowed}." if number else f"{key} must be {allowed}."
    return f"{table}{', '.join([key, *inner])} = {as_written(problem.value)} is not allowed. {rule}"


def _description(root: type[BaseModel], path: list[str]) -> str:
    """What is allowed for the key at ``path``; empty where there is no such key."""
    field = field_of(table_at(root, path[:-1]), path[-1])
    return (field.description or "") if field is not None else ""


def with_dates(tables: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of ``tables`` in which days and moments that are text (ISO 8601) are what TOML makes of them."""
    copied: dict[str, Any] = copy.deepcopy(dict(tables))

    def inside(table: object, key: str) -> Any:
        return table.get(key) if isinstance(table, Mapping) else None

    def convert(entries: object, key: str, parse: Callable[[str], dt.date]) -> None:
        for table in entries if isinstance(entries, list) else ():
            if isinstance(table, dict) and isinstance(table.get(key), str):
                with contextlib.suppress(ValueError):  # the check of the tables says what a day or a moment must look like
                    table[key] = parse(table[key])

    convert([copied.get("weather")], "start", dt.date.fromisoformat)
    convert(inside(copied.get("scenario"), "seasons"), "start", dt.date.fromisoformat)
    prices = copied.get("price_tables")
    for table in prices.values() if isinstance(prices, Mapping) else ():
        convert(inside(table, "series"), "time", dt.datetime.fromisoformat)
    return copied


def changed_tables(base: Mapping[str, Any], base_id: str, *changes: Mapping[str, Any]) -> tuple[TaskTables, str]:
    """The tables of a task with all of ``changes``, and what messages call the result; see ``TaskSpec.replace``.

    ``base`` are the tables of the task ``base_id``.

    Raises ``TaskError`` when the changes are no tables of a task, or have the id of a shipped task.
    """
    own_id = f"{OWN_NAMESPACE}/{base_id.partition('/')[2]}"
    names_to_drop: list[str] = []
    tables: dict[str, Any] = {}
    for change in changes:
        if not isinstance(change, Mapping):
            refuse(f'{own_id}: changes of a task are a mapping such as {{"weather.days": 30}}; got {change!r}.', TaskError)
        for key, value in _nested(change, names_to_drop, "").items():
            _add(tables, key, value, "")
    own = {"id": own_id, "title": f"{base['title']}, changed", **tables}
    source = own["id"] if isinstance(own["id"], str) else own_id
    if names_to_drop and isinstance(listed := own.get(WITHOUT, []), list):
        own[WITHOUT] = [*listed, *names_to_drop]
    if own["id"] in task_ids():
        msg = (
            f"'{own['id']}' is the id of a task that comes with glbench. A changed task needs an id of its own: "
            f'replace(..., id="{own_id}").'
        )
        raise TaskError(msg)
    check_plain(own, source)
    take_over_prices(own, Path(), source, base)
    return inherit(base, with_dates(own), base_id, source), source


def _nested(changes: Mapping[str, Any], names_to_drop: list[str], prefix: str) -> dict[str, Any]:
    """Tables in tables of keys such as ``weather.days``; keys whose value is ``None`` go to ``names_to_drop``."""
    nested: dict[str, Any] = {}
    for key, value in changes.items():
        if not isinstance(key, str) or not all(key.split(".")):
            refuse(f'{prefix}{key!r} is not a key of a task. A key is text such as "weather.days".', TaskError)
        first, _, rest = key.partition(".")
        if value is None and not rest:
            names_to_drop.append(f"{prefix}{first}")
            continue
        inside = {rest: value} if rest else value
        if isinstance(inside, Mapping):
            table = _nested(inside, names_to_drop, f"{prefix}{first}.")
            if inside and not table:
                continue  # all of it is left out
            _add(nested, first, table, prefix)
        else:
            _add(nested, first, _plain(inside, f"{prefix}{first}"), prefix)
    return nested


def _add(table: dict[str, Any], key: str, value: Any, prefix: str) -> None:
    """Put ``value`` at ``key`` of ``table``; tables are merged."""
    there = table.get(key)
    if isinstance(there, dict) and isinstance(value, dict):
        for inner, entry in value.items():
            _add(there, inner, entry, f"{prefix}{key}.")
    elif key in table:
        refuse(f"{prefix}{key} is given twice. Keep one of the two.", TaskError)
    else:
        table[key] = value


def _plain(value: object, key: str) -> object:
    """``value`` as a task file could hold it."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(entry, key) for entry in value]
    if isinstance(value, Mapping):
        return {str(name): _plain(entry, f"{key}.{name}") for name, entry in value.items()}
    if isinstance(value, str | bool | int | float | dt.date):
        return value
    msg = f"{key} is a value of the type {type(value).__name__}. A task holds text, numbers, True and False, dates, lists and tables."
    raise TaskError(msg)
