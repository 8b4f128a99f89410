"""A task made of another one and of what differs, in Python: what a task file does that names its base.

``TaskSpec.replace`` and the keyword ``overrides`` of the environments lead here. What is given becomes the tables of a task file with
that base, and goes the way of such a file: put together with the base, checked, resolved.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glbench.errors import TaskError
from glbench.registration import task_ids
from glbench.tasks.bases import WITHOUT, Written, check_plain, combined, take_over_prices
from glbench.tasks.reading import task_of
from glbench.tasks.written import tables_of, with_dates

if TYPE_CHECKING:
    from glbench.tasks.spec import TaskSpec

OWN_NAMESPACE = "my"
"""Namespace of a changed task that is given no id."""

_REPEATED = "{key} is given twice. Keep one of the two."


def replaced(task: TaskSpec, *changes: Mapping[str, Any]) -> TaskSpec:
    """``task`` with all of ``changes``; see ``TaskSpec.replace``."""
    own_id = f"{OWN_NAMESPACE}/{task.short_id}"
    left_out: list[str] = []
    given: dict[str, Any] = {}
    for one in changes:
        if not isinstance(one, Mapping):
            msg = f'{own_id}: changes of a task are a mapping such as {{"weather.days": 30}}; got {one!r}.'
            raise TaskError(msg)
        for key, value in _nested(one, left_out, "").items():
            _add(given, key, value, "")
    own = {"id": own_id, "title": f"{task.title}, changed", **given}
    shown = own["id"] if isinstance(own["id"], str) else own_id
    if left_out and isinstance(named := own.get(WITHOUT, []), list):
        own[WITHOUT] = [*named, *left_out]
    if own["id"] in task_ids():
        msg = (
            f"'{own['id']}' is the id of a task that comes with glbench. A changed task needs an id of its own: "
            f'replace(..., id="{own_id}").'
        )
        raise TaskError(msg)
    check_plain(own, shown)
    below = tables_of(task)
    take_over_prices(own, Path(), shown, below)
    made = _made(combined(below, with_dates(own), task.id, shown), shown)
    has = made.splits.names if made.splits is not None else ()
    return made.in_split(task.split, task.sealed) if task.split in has and task.split is not None else made


@lru_cache(maxsize=64)
def _made(written: Written, shown: str) -> TaskSpec:
    """The task of these tables. Whatever cannot be resolved is reported now and not in the middle of a run."""
    task = task_of(written, shown)
    task.fingerprint()
    return task


def _nested(given: Mapping[str, Any], left_out: list[str], prefix: str) -> dict[str, Any]:
    """Tables in tables of keys such as ``weather.days``; those whose value is ``None`` go to ``left_out``."""
    nested: dict[str, Any] = {}
    for key, value in given.items():
        if not isinstance(key, str) or not all(key.split(".")):
            msg = f'{prefix}{key!r} is not a key of a task. A key is text such as "weather.days".'
            raise TaskError(msg)
        first, _, rest = key.partition(".")
        if value is None and not rest:
            left_out.append(f"{prefix}{first}")
            continue
        inside = {rest: value} if rest else value
        if isinstance(inside, Mapping):
            table = _nested(inside, left_out, f"{prefix}{first}.")
            if inside and not table:
                continue  # all of it is left out
            _add(nested, first, table, prefix)
        else:
            _add(nested, first, _plain(inside, f"{prefix}{first}"), prefix)
    return nested


def _add(table: dict[str, Any], key: str, value: Any, prefix: str) -> None:
    """``value`` at ``key`` of ``table``; two tables are put together."""
    there = table.get(key)
    if isinstance(there, dict) and isinstance(value, dict):
        for inner, entry in value.items():
            _add(there, inner, entry, f"{prefix}{key}.")
    elif key in table:
        raise TaskError(_REPEATED.format(key=f"{prefix}{key}"))
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
    msg = (
        f"{key} is a value of the type {type(value).__name__}. "
        "A task holds text, numbers, True and False, dates, lists and tables."
    )
    raise TaskError(msg)
