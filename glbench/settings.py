"""Settings files (YAML or TOML): read one into a pydantic model, and report what is wrong with it.

A message names the file, the setting, its value, its unit and bounds, and the nearest known name.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from glbench.errors import GlbenchError, SubmissionError, did_you_mean, refuse
from glbench.untrusted import decimal_point, place_of, quoted, read_regular, reason_of, toml_fault
from glbench.yaml_reader import read_yaml

_LARGEST_TOML = 64 * 1024
_MOST_DOTS = 500  # Most dots in a line: the time to read a key grows with the square of the number of its parts

Model = TypeVar("Model", bound=BaseModel)


class Table(BaseModel):
    """Base class of settings: frozen, and refuses unknown keys and NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Problem(NamedTuple):
    """One error of pydantic."""

    place: tuple[str | int, ...]
    """Keys and indices from the top of the document."""
    kind: str
    """Pydantic's name for the error, such as ``missing``."""
    value: Any
    reason: str
    """Pydantic's message, or that of the validator that refused the value."""


def problems_of(error: ValidationError) -> list[Problem]:
    """All errors, in the order of the model's fields."""
    details = error.errors(include_url=False)
    return [Problem(one["loc"], one["type"], one["input"], one["msg"].removeprefix("Value error, ")) for one in details]


def first_problems(error: ValidationError, most: int = 1) -> str:
    """``"runs.0.seed: Field required; and 3 more"``: for records that programs write and users cannot correct."""
    problems = problems_of(error)
    words = [": ".join(filter(None, (place_of(one.place), one.reason))) for one in problems[:most]]
    return "; ".join([*words, f"and {len(problems) - most} more"] if len(problems) > most > 1 else words)


def readable_errors(error: ValidationError, model: type[BaseModel], inline: str = "") -> str:
    """What is wrong with the settings of ``model``, as the end of a sentence, including the full stop.

    ``inline`` is a field whose entries are at the top level of the file, so messages do not name it.
    """
    problems = (one._replace(place=one.place[one.place[:1] == (inline,) :]) for one in problems_of(error))
    text = "; ".join(dict.fromkeys(_in_words(problem, model) for problem in problems))
    return text if text.endswith((".", "?")) else f"{text}."


def read_settings(
    model: type[Model], file: Path, what: str, error_type: type[GlbenchError] = SubmissionError, *, toml: bool = False, advice: str = ""
) -> Model:
    """The settings in a YAML file, or with ``toml`` in a TOML file.

    ``what`` names the file in messages, such as ``"the rules"``; ``advice`` is a sentence at the end of messages. Raises an ``error_type``
    when the file cannot be read, lacks a setting, or has an unknown or impossible one.
    """
    if toml:
        try:
            content = read_toml(file)
        except SubmissionError as error:
            raise error_type(_unusable(what, file, f"{error}.", advice)) from error
    else:
        content = read_yaml(file, what, error_type)
    return validated(model, content, what, file, error_type, advice=advice)


def validated(
    model: type[Model],
    content: dict[str, Any],
    what: str,
    file: Path,
    error_type: type[GlbenchError] = SubmissionError,
    *,
    advice: str = "",
    inline: str = "",
) -> Model:
    """The ``content`` of ``file`` as a ``model``. Parameters and errors as for ``read_settings`` and ``readable_errors``."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise error_type(_unusable(what, file, readable_errors(error, model, inline), advice)) from error


def read_toml(file: Path) -> dict[str, Any]:
    """The content of a small TOML file. Raises ``SubmissionError`` when it is none, in words that go on after "it", without a full stop."""
    text = ""
    try:
        text = read_regular(file, _LARGEST_TOML).decode("utf-8-sig").replace("\r\n", "\n")
        if any(line.count(".") > _MOST_DOTS for line in text.splitlines()):
            refuse(f"it has a line with more than {_MOST_DOTS} dots, and no key of a card has two", SubmissionError)
        return tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        refuse(f"it cannot be read ({reason_of(error)})", SubmissionError, error)
    except ValueError as error:  # tomllib's own, and Python's for an integer of thousands of digits
        refuse(f"it is no valid TOML ({toml_fault(error, text)})", SubmissionError, error)
    except RecursionError as error:
        refuse("it is no valid TOML (its tables or lists are nested without end)", SubmissionError, error)


def table_at(model: type[BaseModel], place: Sequence[str | int]) -> type[BaseModel] | None:
    """The model of the table at a place below ``model``, even inside a table or list of tables; ``None`` if there is none."""
    table: type[BaseModel] | None = model
    keys = iter(place)
    for key in keys:
        annotation = getattr(field_of(table, key), "annotation", None)
        candidates = (candidate for candidate in (annotation, *get_args(annotation)))
        table = next((one for one in candidates if isinstance(one, type) and issubclass(one, BaseModel)), None)
        if get_origin(annotation) in (dict, list, tuple):  # the next key is a name or an index
            next(keys, None)
    return table


def field_of(table: type[BaseModel] | None, key: str | int) -> FieldInfo | None:
    """The field with this name or alias; ``None`` if there is none."""
    fields = {} if table is None else table.model_fields
    return next((field for name, field in fields.items() if key in (name, field.alias)), None)


def _unusable(what: str, file: Path, reason: str, advice: str) -> str:
    return f"{what[:1].upper()}{what[1:]} {file} cannot be used: {reason}{advice and f' {advice}'}"


def _in_words(problem: Problem, model: type[BaseModel]) -> str:
    """Message for a problem: the setting, its value, unit and bounds, or the nearest name."""
    place, kind, value, reason = problem
    name, table = quoted(".".join(map(str, place)) or "file"), table_at(model, place[:-1])
    if kind == "missing":
        return f"{name} is missing"
    if kind == "extra_forbidden":
        names = [] if table is None else [field.alias or key for key, field in table.model_fields.items()]
        return f"there is no setting {name}.{did_you_mean(str(place[-1]), names)}".rstrip(".")
    if kind in ("float_parsing", "float_type"):
        advice = decimal_point(value) if isinstance(value, str) else ""
        return f"{name} is {quoted(value)}, which is not a number{advice and f': {advice}'}"
    if kind in ("greater_than_equal", "less_than_equal") and (field := field_of(table, place[-1])) is not None:
        low = next((float(limit.ge) for limit in field.metadata if hasattr(limit, "ge")), None)
        high = next((float(limit.le) for limit in field.metadata if hasattr(limit, "le")), None)
        about = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        unit = f" {about['unit']}" if about.get("unit", "-") != "-" else ""
        if low is not None and high is not None:
            return f"{name} is {value:g}{unit}; it must be from {low:g} to {high:g}{unit}"
    if kind != "value_error":
        reason = f"{reason[:1].lower()}{reason[1:]}"
    return f"{quoted(place_of(place))}: {reason}" if place_of(place) else reason
