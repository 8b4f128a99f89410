"""A task's definition as JSON inside a record, and back: a record of a user's own task can be replayed without the task's file."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from glbench.errors import EpisodeError
from glbench.untrusted import parse_json, visible

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

_UNITS: dict[str, dict[str, str]] = {
    "initial_state": {"air_temperature": "degC"},
    "prices": {
        "fruit": "EUR kg-1", "dry_matter_content": "kg kg-1", "co2": "EUR kg-1", "heat": "EUR kWh-1", "electricity": "EUR kWh-1",
    },
    "penalty_scale": {"air_temperature": "degC", "co2": "ppm", "relative_humidity": "%"},
    "failed_step": {"epi": "EUR m-2"},
    "time_limits": {"start": "s", "step": "s", "run": "s"},
}  # fmt: skip
"""Fields that a task file writes with their unit and a task holds as plain numbers."""


def definition_json(task: TaskSpec) -> bytes:
    """The definition of ``task``, prose included, as JSON for people and programs."""
    if task.schema_version > 1:
        return (json.dumps(task.written(), indent=2, ensure_ascii=False) + "\n").encode()
    plain: dict[str, Any] = task.model_dump(mode="json", by_alias=True)
    plain["model"]["overrides"] = {name: [value, unit] for name, value, unit in task.model.overrides}
    return (json.dumps(plain, indent=2, ensure_ascii=False) + "\n").encode()


def task_of(definition: bytes) -> TaskSpec:
    """The task that a record's attached definition defines. Whether it is the right one, its digest tells.

    Raises
    ------
    EpisodeError
        When the attachment defines no task.
    """
    from glbench.tasks import TaskSpec

    try:
        plain = parse_json(definition)
        if plain.get("schema") != 1:
            return TaskSpec.of_written(plain)
        return TaskSpec.model_validate(_as_written(plain))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, ValidationError) as error:
        msg = f"The task definition in the record cannot be read ({visible(' '.join(str(error).split())[:200])}). Evaluate again."
        raise EpisodeError(msg) from error


def _as_written(plain: Mapping[str, Any]) -> dict[str, Any]:
    """The definition as a task file writes it: dates as dates, numbers with their units."""
    written = {key: dict(value) if isinstance(value, Mapping) else value for key, value in plain.items()}
    written["weather"]["start"] = dt.date.fromisoformat(written["weather"]["start"])
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
            continue
        owner[table] = {
            key: {"value": value, "unit": units[key]} if key in units else value for key, value in owner[table].items()
        }
    written["observation"] = {key: value for key, value in written["observation"].items() if value is not None}
    return written
