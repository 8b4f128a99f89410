"""The digest of a task, by the recipe of its schema. The recipes are frozen: published tasks and results depend on them.

A digest is the SHA-256 of canonical JSON (RFC 8785) over: the definition without prose, the resolved parameters, the state at the start,
the names, units and bounds of the observed columns, the weather, and the model's equations; for schema 2, also over the ledger and the
names of drawn parameters. Each part also has its own digest, by which a mismatch is traced. Computed numbers are rounded to nine
significant digits, because the last bit of ``exp`` may differ between machines.

A published task never changes. ``tasks/lock.toml`` keeps the digest of every part, so that a message can tell an edited file from a
changed model or changed weather (``glbench.tasks.library``).
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from glbench.canonical import canonical_sha256
from glbench.errors import TaskError, UnknownNameError, did_you_mean, refuse
from glbench.resources import data_folder, write_atomically
from glbench.tasks.quantities import CAMERA
from glbench.tasks.record import TaskRecord
from glbench.tasks.resolver import ResolvedTask, Season
from glbench.tasks.spreads import ATTEMPTS, HEAT
from glbench.tasks.tables import PROCESS_COMPUTER

PROSE = frozenset({"title", "description", "suites"})
"""Fields that explain or classify a task and do not change it: its digest leaves them out."""
DIGITS = 9
"""Significant digits in a digest for numbers that are computed, not read."""

SCHEMA_1: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "schema": (),
        "id": (),
        "weather": ("source", "preprocessing", "start", "days", "step_seconds", "co2_ppm"),
        "model": ("variant", "parameters", "overrides"),
        "initial_state": ("kind", "air_temperature"),
        "uncertainty": ("distribution", "delta", "half_width_factor", "parameters", "redraw"),
        "observation": ("modules", "timing", "forecast"),
        "actuation": ("kind", "max_change", "controls"),
        "constraints": ("air_temperature", "co2", "relative_humidity"),
        "prices": ("fruit", "dry_matter_content", "co2", "heat", "electricity"),
        "reward": ("modules", "penalty_scale"),
        "evaluation": ("first_seed", "runs", "metric", "failed_step"),
    }
)
"""The keys that the digest of a task of schema 1 covers, even if keys are added later; ``evaluation.time_limits`` if it is given."""

_EVEN = 0.6180339887498949
"""Its multiples, modulo 1, are evenly spread."""
_GRID = 6180.339887498949  # weather rows enter a digest in steps of 1/6180: no round number lies halfway between two of them

LOCK_NAME = "lock.toml"
LOCK_WORDS = "tasks/lock.toml"

_HEADER = """\
# Digests of the published tasks, written by `glbench tasks lock`. A published task never changes: entries are added, never
# edited. `digest` covers the whole task; the other lines say which part of it differs when it no longer matches.
"""


@dataclass(frozen=True)
class Fingerprint:
    """The digest of a task [SHA-256, hex] and the digests of its parts."""

    digest: str
    definition: str
    parameters: str
    start: str
    observation: str
    weather: str
    model: str
    model_version: str

    PARTS: ClassVar[tuple[str, ...]] = ("definition", "parameters", "start", "observation", "weather", "model")


@dataclass(frozen=True)
class LockEntry:
    """A published task: its file in the tasks folder and its fingerprint."""

    id: str
    file: str
    fingerprint: Fingerprint

    @property
    def digest(self) -> str:
        """Digest of the task [SHA-256, hex]."""
        return self.fingerprint.digest


def definition_of(task: TaskRecord) -> dict[str, Any]:
    """The content of the file without prose, as plain JSON values: the part of the digest that comes from the file."""
    schema_1 = task.schema_version == 1
    whole = task.file.plain(mode="json", by_alias=True, exclude=set(PROSE), exclude_defaults=not schema_1)
    plain = {**whole, "schema": task.schema_version}
    if schema_1:
        plain = {table: {key: whole[table][key] for key in keys} if keys else whole[table] for table, keys in SCHEMA_1.items()}
        if task.evaluation.time_limits is not None:  # a task that says nothing about time has the digest it always had
            plain["evaluation"]["time_limits"] = whole["evaluation"]["time_limits"]
    if plain["model"].pop("overrides", None) is not None:
        plain["model"]["overrides"] = {name: [value, unit] for name, value, unit in task.model.overrides}
    return plain


def fingerprint_of(task: ResolvedTask) -> Fingerprint:
    """The digests of ``task`` and its parts; needs model and weather. Raises ``TaskError`` when it refers to what does not exist."""
    model = task.model_value
    for name in task.actuation.controls:
        with task.errors_in("actuation"):
            if name not in model.control_names:
                refuse(f"There is no control called '{name}'.{did_you_mean(name, model.control_names)}", UnknownNameError)
    _ = task.scenario, task.ledger, task.scheduled_places, task.initial_controls  # what is unknown is an error before anything is recorded
    if model.air is None and task.constraints.items():
        refuse(f"{task.source}: [constraints] {model.id} has no air whose climate could be limited. Leave the table out.", TaskError)
    parts = _parts(task)
    named = {name: canonical_sha256(part) for name, part in parts.items() if name in Fingerprint.PARTS}
    return Fingerprint(digest=canonical_sha256(parts), **named, model_version=model.version)


def _parts(task: ResolvedTask) -> dict[str, Any]:
    """What the digest covers, by the recipe of the task's schema."""
    model = task.model_value
    parts: dict[str, Any] = {
        "definition": definition_of(task),
        "parameters": {name: _rounded(value) for name, value in task.parameters_by_name().items()},
        "start": [_rounded(value) for value in task.initial_state().tolist()],
        "observation": [[q.name, q.unit, _rounded(q.low), _rounded(q.high)] for q in task.observed()],
        "model": {"version": model.version, "variant": model.variant, "digest": model.digest},
    }
    if task.picture_library is not None:
        parts["observation"].append([CAMERA, task.picture_library.digest])
    if task.schema_version == 1:
        return {**parts, "weather": task.disturbances(task.observation.forecast_steps).digest}
    parts["start"] = dict(zip(model.state_names, parts["start"], strict=True))
    parts["weather"] = _weather_digests(task)
    parts["model"]["id"] = model.id
    parts["ledger"] = [
        [item.name, item.flow, item.amount, item.amount_unit, item.factor, item.price, item.sign, item.valued]
        for item in task.ledger.items
    ]  # fmt: skip
    parts["draws"] = [[group.name, list(group.parameters)] for group in task.scenario.groups]
    for draw, group in zip(parts["draws"], task.scenario.groups, strict=True):
        if group.spread is not None:
            draw.append([group.spread.factor, list(HEAT), ATTEMPTS, [list(row) for row in group.spread.rows]])
    if task.actuation.kind == PROCESS_COMPUTER:
        parts["actuation"] = {
            "settings": task.actuation.process_computer.model_dump(),
            "actions": [[one.name, one.unit, one.low, one.high, one.lowest, one.highest] for one in task.actions],
        }
    return parts


def _weather_digests(task: ResolvedTask) -> list[list[str]]:
    """Digests of the weather of all splits, whichever split the task is in."""
    from glbench.weather import SeasonGenerator

    splits = task.splits
    if splits is None:
        return [_season_digest(task, season) for season in task.scenario.seasons]
    digests: list[list[str]] = []
    for name in splits.names:
        scenario = task.in_split(name).scenario
        if scenario.generated is None:
            digests += [[name, *_season_digest(task, season)] for season in scenario.seasons]
        else:
            years = map(str, scenario.generated.years)
            with task.errors_in(f"splits.{name}"):
                generator = SeasonGenerator(task.record(), getattr(splits, name).years)
            # of one season: whole numbers, the same on every machine
            numbers = np.asarray(np.arange(1, generator.numbers(task.weather.days) + 1) * _EVEN % 1.0, np.float64)
            season = generator.season(task.weather.start, task.weather.days, numbers)
            digests.append([name, "generated", *years, season.record.digest])
    return digests


def _season_digest(task: ResolvedTask, season: Season) -> list[str]:
    rows = task.season(season, task.observation.forecast_steps)
    calendar = np.column_stack([rows.values, rows.hour_of_day, rows.day_of_year])
    steps = np.rint(calendar * _GRID).astype("<i8")
    return [season.source, season.start.isoformat(), hashlib.sha256(steps.tobytes()).hexdigest()]


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def lock_path() -> Path:
    """Path of the lock."""
    return data_folder("tasks") / LOCK_NAME


def read_lock() -> Mapping[str, LockEntry]:
    """Entries of the lock by task id; empty if there is no lock yet. Raises ``TaskError`` when the file is damaged."""
    path = lock_path()
    try:
        state = path.stat()
    except FileNotFoundError:
        return MappingProxyType({})
    return _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=8)
def _read(path: Path, _modified: int, _size: int) -> Mapping[str, LockEntry]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        names, entries = {field.name for field in fields(Fingerprint)}, {}
        for task_id, entry in content.items():
            if not isinstance(entry, dict) or set(entry) != {"file", *names} or not all(isinstance(value, str) for value in entry.values()):
                refuse(f"the entry of '{task_id}' is not complete")
            entries[task_id] = LockEntry(task_id, entry["file"], Fingerprint(**{name: entry[name] for name in names}))
        return MappingProxyType(entries)
    except (OSError, ValueError) as error:
        refuse(f"Cannot read {path}: {error}. Restore the file, or install glbench again.", TaskError, error)


def write_lock(entries: Mapping[str, LockEntry], path: Path) -> None:
    """Write ``entries`` in the order of their ids."""
    blocks = [_HEADER]
    for task_id in sorted(entries):
        entry = entries[task_id]
        lines = {"file": entry.file, **asdict(entry.fingerprint)}
        blocks.append(f'["{task_id}"]\n' + "".join(f'{key} = "{value}"\n' for key, value in lines.items()))
    write_atomically(path, "\n".join(blocks))
