"""What is wrong with a page of settings, in words for the person who wrote it.

The readers of the pages are part of the released agents' digests and stay as they are. Their errors are rewritten with value, unit and
bounds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from pydantic import BaseModel, ValidationError

from glbench.errors import SubmissionError, did_you_mean
from glbench.untrusted import quoted

_DECIMAL_COMMA = re.compile(r"\s*([+-]?\d+),(\d+)\s*")


@contextmanager
def said_better(module: str) -> Iterator[None]:
    """Rewrite the errors of the reader in ``module``.

    Raises
    ------
    SubmissionError
        With file, line or setting, value, unit and bounds.
    """
    try:
        yield
    except SubmissionError as error:
        cause = error.__cause__
        if not isinstance(cause, ValidationError):
            raise
        kind = getattr(import_module(f"glbench.agents.{module}"), cause.title, None)
        head = str(error).partition(" cannot be used: ")[0]
        problems = "; ".join(dict.fromkeys(_in_words(problem, kind) for problem in cause.errors()))
        msg = f"{head} cannot be used: {problems}."
        raise SubmissionError(msg) from cause


def _in_words(problem: Any, page: type[BaseModel] | None) -> str:
    """A problem of pydantic with the setting, its value, unit and bounds, or the nearest name."""
    place, given, kind = [str(part) for part in problem["loc"]], problem["input"], problem["type"]
    name = ".".join(place) or "file"
    table = _table_of(page, place[:-1])
    known = [] if table is None else [field.alias or key for key, field in table.model_fields.items()]
    if kind == "missing":
        return f"{quoted(name)} is missing"
    if kind == "extra_forbidden":
        return f"there is no setting {quoted(name)}.{did_you_mean(place[-1], known)}".rstrip(".")
    if kind in ("float_parsing", "float_type"):
        comma = _DECIMAL_COMMA.fullmatch(given) if isinstance(given, str) else None
        point = f"; write it with a point, {comma[1]}.{comma[2]}" if comma else ""
        return f"{quoted(name)} is {quoted(given)}, which is not a number{point}"
    if kind in ("greater_than_equal", "less_than_equal"):
        low, high, unit = _about(table, place[-1])
        if low is not None and high is not None:
            return f"{quoted(name)} is {given:g}{unit}; it must be from {low:g} to {high:g}{unit}"
    said = str(problem["msg"]).removeprefix("Value error, ")
    return f"{quoted(name)}: {said[:1].lower()}{said[1:]}" if place else said


def _table_of(page: type[BaseModel] | None, place: Sequence[str]) -> type[BaseModel] | None:
    for part in place:
        field = None if page is None else page.model_fields.get(part)
        found = None if field is None else field.annotation
        page = found if isinstance(found, type) and issubclass(found, BaseModel) else None
    return page


def _about(table: type[BaseModel] | None, name: str) -> tuple[float | None, float | None, str]:
    """Lowest and highest value of a setting, and its unit after a space."""
    field = None if table is None else table.model_fields.get(name)
    if field is None:
        return None, None, ""
    low = next((float(limit.ge) for limit in field.metadata if hasattr(limit, "ge")), None)
    high = next((float(limit.le) for limit in field.metadata if hasattr(limit, "le")), None)
    unit = field.json_schema_extra.get("unit") if isinstance(field.json_schema_extra, dict) else None
    return low, high, f" {unit}" if isinstance(unit, str) and unit != "-" else ""
