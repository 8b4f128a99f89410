"""Reading a task file: from TOML to a ``TaskSpec``, with every mistake told in words.

A message names the file, the table, the key, the value found and what is allowed. All mistakes of a file are listed at once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from glbench.errors import TaskError, did_you_mean
from glbench.settings import Problem, problems_of
from glbench.tasks.bases import Written, as_written, read_written, shown_path
from glbench.tasks.spec import TaskSpec, file_of, schema_of
from glbench.tasks.tables import Table

_NO_NUMBER = ("finite_number", "float_type", "float_parsing")


def read_task(path: Path) -> TaskSpec:
    """Task of the file ``path``. Checks everything that can be checked without the model and the weather.

    Raises
    ------
    TaskError
        When the file or its base cannot be read, is not TOML, or they do not define a task.
    """
    return task_of(read_written(path), shown_path(path))


def task_of(written: Written, shown: str) -> TaskSpec:
    """Task of the tables of a file that messages call ``shown``. Errors as for ``read_task``."""
    try:
        file = file_of(written.content)
    except ValidationError as error:
        root = schema_of(written.content)
        problems = list(dict.fromkeys(_explain(root, problem) for problem in problems_of(error)))
        raise TaskError(
            _listed(shown if written.base is None else f"{shown} (base {written.base})", problems)
        ) from None
    return TaskSpec(file, shown, written.base, written.changes)


def _listed(shown: str, problems: list[str]) -> str:
    if len(problems) == 1:
        return f"{shown}: {problems[0]}"
    return f"{shown} has {len(problems)} mistakes:\n" + "\n".join(f"  - {problem}" for problem in problems)


def _explain(root: type[BaseModel], problem: Problem) -> str:
    """One mistake in words."""
    *tables, key = [str(part) for part in problem.place] or ["the file"]
    place = f"[{'.'.join(tables)}] " if tables else ""
    owner, kind = _table_at(root, tables), problem.kind
    allowed = _description(owner, key)
    if kind == "missing":
        if _is_table(owner, key):
            return f"the table [{'.'.join([*tables, key])}] is missing."
        return f"{place}lacks the key '{key}': {allowed or 'it is required'}."
    if kind == "extra_forbidden":
        known = _keys(owner)
        near = did_you_mean(key, known) or f" Known: {', '.join(known)}."
        return f"'{key}' is not a key {f'of {place}'.rstrip() if tables else 'or table of a task'}.{near}"
    if kind == "model_type":
        return f"[{'.'.join([*tables, key])}] must be a table, not {as_written(problem.value)}."
    if kind == "value_error":
        if _is_table(owner, key) or _is_entry(root, tables):
            return f"[{'.'.join([*tables, key])}] {problem.reason}"
        if not problem.place:  # about more than one table: it names them
            return problem.reason
        return f"{place}{key} = {as_written(problem.value)}: {problem.reason}"
    if not allowed:
        return _inside(root, [*tables, key], problem)
    return f"{place}{key} = {as_written(problem.value)} is not allowed. It must be {allowed}."


def _inside(root: type[BaseModel], parts: list[str], problem: Problem) -> str:
    """A mistake inside the value of a key: which key, where in its list, and what must be there."""
    described = (
        (place, allowed)
        for place in range(len(parts) - 1, -1, -1)
        if (allowed := _description(_table_at(root, parts[:place]), parts[place]))
    )
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


def _table_at(root: type[BaseModel], tables: list[str]) -> type[BaseModel]:
    """The record that describes the table with these names."""
    found, names = root, iter(tables)
    for name in names:
        inner = _record_of(found, name)
        if inner is None:
            break
        if get_origin(_field(found, name).annotation) in (dict, tuple):  # tables by name, or one after the other
            next(names, None)
        found = inner
    return found


def _field(owner: type[BaseModel], key: str) -> Any:
    for name, field in owner.model_fields.items():
        if key in (name, field.alias) and key in _keys(owner):
            return field
    return None


def _record_of(owner: type[BaseModel], key: str) -> type[BaseModel] | None:
    field = _field(owner, key)
    if field is None:
        return None
    for candidate in (field.annotation, *get_args(field.annotation)):
        if isinstance(candidate, type) and issubclass(candidate, Table):
            return candidate
    return None


def _is_table(owner: type[BaseModel], key: str) -> bool:
    return _record_of(owner, key) is not None


def _is_entry(root: type[BaseModel], tables: list[str]) -> bool:
    """Whether what stands right below ``tables`` is one of several tables."""
    if not tables:
        return False
    owner = _table_at(root, tables[:-1])
    return _is_table(owner, tables[-1]) and get_origin(_field(owner, tables[-1]).annotation) in (dict, tuple)


def _keys(owner: type[BaseModel]) -> list[str]:
    """Keys of a table as a file writes them."""
    return [field.alias or name for name, field in owner.model_fields.items()]


def _description(owner: type[BaseModel], key: str) -> str:
    field = _field(owner, key)
    return (field.description or "") if field is not None else ""
