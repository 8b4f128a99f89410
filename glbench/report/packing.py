"""Profiles inside the page: the columns that it draws, no finer than a screen can show, the weather of a task only once.

A profile holds more, and finer, than a page draws. What is embedded is rounded to a share of the largest value of its column (``LEVELS``
steps between 0 and it) and written as differences from the number before, which compresses better. So 200 results stay one file of a
size that can be sent by mail; the tests hold every number to half a step of what the profile says.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from operator import sub
from typing import Any

from glbench.evaluation.profiles import Profile
from glbench.leaderboard.catalogue import catalogue, drawn
from glbench.report.collecting import Known
from glbench.tasks import TaskSpec

LEVELS: Mapping[str, int] = {
    "day": 400,
    "season": 1000,
    "worst": 160,
    "hours": 3000,
    "calendar": 120,
    "weather": 400,
    "energy": 4000,
}
"""Steps between 0 and the largest value of a column: charts of a day are 140 pixels high, sums by hour of the day are money."""


@cache
def drawn_columns(task: TaskSpec | None) -> Mapping[str, frozenset[str]]:
    """Columns of each part of a profile that the page draws of a task; of the calendar all."""
    known, shown = catalogue(task), drawn(task)
    charts = shown.charts
    penalty = [metric.name for metric in known.of_kind("penalty")]
    return {
        "day": frozenset((*shown.controls, *charts["day"], *charts["more"], *charts["climate"], *charts["compared"])),
        "season": frozenset(charts["season"]),
        "worst": frozenset(
            (*penalty, *(line["column"] for panel in shown.panels for line in panel["lines"] if "column" in line))
        ),
        "hours": frozenset((*penalty, *(item.column for item in known.items))),
    }


@dataclass
class Blocks:
    """Compressed pieces of the page by the name under which its script finds them; equal pieces are kept once."""

    by_name: dict[str, str] = field(default_factory=dict)
    _names: dict[str, str] = field(default_factory=dict)

    def add(self, kind: str, document: Any) -> str:
        """Keep ``document`` and return its name."""
        packed = squeezed(json.dumps(document, sort_keys=True, separators=(",", ":")).encode())
        name = self._names.setdefault(packed, f"{kind}-{len(self.by_name)}")
        self.by_name[name] = packed
        return name


def squeezed(text: bytes) -> str:
    """Text as gzip in base64, which every browser of the last years opens by itself."""
    return base64.b64encode(gzip.compress(text, compresslevel=9, mtime=0)).decode("ascii")


def profile_blocks(
    known: Sequence[Known], tasks: Mapping[str, TaskSpec | None], blocks: Blocks
) -> tuple[dict[tuple[str, str], str], dict[str, str]]:
    """Names of the profiles by task id and ``results_digest``, and of the weather by task id."""
    profiles: dict[tuple[str, str], str] = {}
    weather: dict[str, str] = {}
    for item in known:
        if item.profile is None:
            continue
        profiles[item.row.task_id, item.row.results_digest] = blocks.add(
            "profile", embedded_profile(item.profile, tasks[item.row.task_id])
        )
    for item in sorted(known, key=lambda one: not one.stored.released):  # what came with glbench knows the weather best
        if item.profile is not None and item.row.task_id not in weather:
            weather[item.row.task_id] = blocks.add("weather", _weather(item.profile.document))
    return profiles, weather


def embedded_profile(profile: Profile, task: TaskSpec | None) -> dict[str, Any]:
    """What the page holds of a profile."""
    document, drawn_of = profile.document, drawn_columns(task)
    energy = {
        part: {name: _coarse(one, LEVELS["energy"]) for name, one in columns.items()}
        for part, columns in document.get("energy", {}).items()
    }
    return {
        **({"energy": energy} if energy else {}),
        "seeds": document["seeds"],
        "day": {
            "slot_seconds": document["day"]["slot_seconds"],
            "columns": _columns("day", drawn_of, document["day"]["columns"]),
        },
        "season": {"columns": _columns("season", drawn_of, document["season"]["columns"])},
        "calendar": {name: _coarse(one, LEVELS["calendar"]) for name, one in document["calendar"].items()},
        "worst": _columns("worst", drawn_of, document["worst"]),
        "hours": _columns("hours", drawn_of, document["hours"]),
    }


def _weather(document: Mapping[str, Any]) -> dict[str, Any]:
    weather, levels = document["weather"], LEVELS["weather"]
    return {
        "slot_seconds": document["day"]["slot_seconds"],
        "day": {name: _coarse(one, levels) for name, one in weather["day"].items()},
        "season": {"columns": {name: _coarse(one, levels) for name, one in weather["season"]["columns"].items()}},
        "hours": {name: _coarse(one, levels) for name, one in weather["hours"].items()},
    }


def _columns(part: str, drawn_of: Mapping[str, frozenset[str]], columns: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _coarse(one, LEVELS[part]) for name, one in columns.items() if name in drawn_of[part]}


def _coarse(packed: Mapping[str, Any], levels: int) -> dict[str, Any]:
    """Whole numbers times a coarser ``resolution``, each as the difference from the known one before it in its row."""
    factor = max(1, _largest(packed["values"]) // levels)
    return {"resolution": packed["resolution"] * factor, "differences": _differences(packed["values"], factor)}


def _largest(cells: Sequence[Any]) -> int:
    if any(isinstance(cell, list) for cell in cells):
        return max(map(_largest, cells))
    return max(map(abs, filter(None, cells)), default=0)


def _differences(cells: Sequence[Any], factor: int) -> list[Any]:
    if any(isinstance(cell, list) for cell in cells):
        return [_differences(row, factor) for row in cells]
    known = [(2 * cell + factor) // (2 * factor) for cell in cells if cell is not None]
    steps = map(sub, known, (0, *known))
    return [None if cell is None else next(steps) for cell in cells]
