"""Profiles inside the page: the columns that it draws, no finer than a screen can show.

The weather of all runs of a task is kept once, the hours of a worst run with each result: the worst runs of two agents can differ.

A profile holds more, and finer, than a page draws. What is embedded is rounded to a share of the largest value of its column (``LEVELS``
steps between 0 and it) and written as differences from the number before, which compresses better. So 200 results stay one file of a
size that can be sent by mail; the tests hold every number to half a step of what the profile says.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.scenario import first_day
from glbench.errors import GlbenchError
from glbench.evaluation.profiles import Profile
from glbench.evaluation.records import TaskRecord
from glbench.leaderboard.catalogue import catalogue, charts_of
from glbench.report.facts import ReportEntry
from glbench.tasks import TaskSpec

LEVELS: Mapping[str, int] = {"day": 400, "season": 1000, "worst": 160, "hours": 3000, "calendar": 120, "weather": 400, "energy": 4000}
"""Steps between 0 and the largest value of a column: charts of a day are 140 pixels high, sums by hour of the day are money."""


@cache
def drawn_columns(task: TaskSpec | None) -> Mapping[str, frozenset[str]]:
    """Columns of each part of a profile that the page draws of a task; of the calendar all, of the weather those of the worst run."""
    labels, drawing = catalogue(task), charts_of(task)
    charts = drawing.charts
    penalty = [metric.name for metric in labels.of_kind("penalty")]
    return {
        "day": frozenset((*drawing.controls, *charts["day"], *charts["more"], *charts["climate"], *charts["compared"])),
        "season": frozenset(charts["season"]),
        "worst": frozenset((*penalty, *(line["column"] for panel in drawing.panels for line in panel["lines"] if "column" in line))),
        "hours": frozenset((*penalty, *(item.column for item in labels.items))),
        "weather": frozenset(line["weather"] for panel in drawing.panels for line in panel["lines"] if "weather" in line),
    }


@dataclass
class Blocks:
    """Compressed pieces of the page by the name under which its script finds them; equal pieces are kept once."""

    by_name: dict[str, str] = field(default_factory=dict)
    _names: dict[str, str] = field(default_factory=dict)

    def add(self, kind: str, documents: Iterable[Any]) -> list[str]:
        """Keep ``documents`` and return their names. All cores compress: zlib takes longer than all the rest of the page."""
        texts = (json.dumps(one, sort_keys=True, separators=(",", ":")).encode() for one in documents)
        names = []
        with ThreadPoolExecutor() as pool:
            for packed in pool.map(squeezed, texts):
                names.append(self._names.setdefault(packed, f"{kind}-{len(self.by_name)}"))
                self.by_name[names[-1]] = packed
        return names


def squeezed(text: bytes) -> str:
    """Text as gzip in base64, which every browser of the last years opens by itself."""
    return base64.b64encode(gzip.compress(text, compresslevel=7, mtime=0)).decode("ascii")


def profile_blocks(
    entries: Sequence[ReportEntry], tasks: Mapping[str, TaskSpec | None], blocks: Blocks
) -> tuple[dict[tuple[str, str], str], dict[str, str]]:
    """Names of the profiles by task id and ``results_digest``, and of the weather over all runs by task id."""
    with_profile = [(item, item.profile) for item in entries if item.profile is not None]
    embedded_profiles = (embedded_profile(one, tasks[item.row.task_id], item.stored.result.task) for item, one in with_profile)
    names = blocks.add("profile", embedded_profiles)
    profiles = {(item.row.task_id, item.row.results_digest): name for (item, _), name in zip(with_profile, names, strict=True)}
    outside: dict[str, Profile] = {}
    for item, one in sorted(with_profile, key=lambda pair: not pair[0].stored.released):  # what came with glbench knows the weather best
        outside.setdefault(item.row.task_id, one)
    levels = LEVELS["weather"]
    embedded = (
        {
            "runs": len(one.document["seeds"].get("starts", ())) or 1,  # with weather of their own
            "slot_seconds": one.document["day"]["slot_seconds"],
            "day": {name: _coarse(column, levels) for name, column in one.document["weather"]["day"].items()},
            "season": {"columns": {name: _coarse(column, levels) for name, column in one.document["weather"]["season"]["columns"].items()}},
        }
        for one in outside.values()
    )
    return profiles, dict(zip(outside, blocks.add("weather", embedded), strict=True))


def embedded_profile(profile: Profile, task: TaskSpec | None, named: TaskRecord) -> dict[str, Any]:
    """What the page holds of a profile; ``named`` is the task as its result names it."""
    document, drawn_of = profile.document, drawn_columns(task)
    energy = {
        part: {name: _coarse(one, LEVELS["energy"]) for name, one in columns.items()}
        for part, columns in document.get("energy", {}).items()
    }
    library = None if task is None else task.picture_library
    contents = map(library.content, document.get("pictures", [])) if library is not None else ()
    pictures = [f"data:image/webp;base64,{base64.b64encode(content).decode('ascii')}" for content in contents]
    return {
        **({"energy": energy} if energy else {}),
        **({"pictures": pictures} if pictures else {}),
        "seeds": document["seeds"],
        "start": _start_of_worst(profile, task, named),
        "day": {"slot_seconds": document["day"]["slot_seconds"], "columns": _columns("day", drawn_of, document["day"]["columns"])},
        "season": {"columns": _columns("season", drawn_of, document["season"]["columns"])},
        "calendar": {name: _coarse(one, LEVELS["calendar"]) for name, one in document["calendar"].items()},
        "worst": _columns("worst", drawn_of, document["worst"]),
        "outside": _columns("weather", drawn_of, document["weather"]["hours"]),
        "hours": _columns("hours", drawn_of, document["hours"]),
    }


def _start_of_worst(profile: Profile, task: TaskSpec | None, named: TaskRecord) -> str | None:
    """First day of the worst run; ``None`` where its task, the task's weather or its secret draws are not here."""
    try:
        scored = None if task is None else task.scored_in(named.split)
        if scored is None or scored.salt_commitment != named.salt_commitment:
            return None
        return first_day(scored, profile.document["seeds"]["worst"]).isoformat()
    except GlbenchError:
        return None


def _columns(part: str, drawn_of: Mapping[str, frozenset[str]], columns: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _coarse(one, LEVELS[part]) for name, one in columns.items() if name in drawn_of[part]}


def _coarse(packed: Mapping[str, Any], levels: int) -> dict[str, Any]:
    """Whole numbers times a coarser ``resolution``, each as the difference from the known one before it in its row."""
    cells = np.array(packed["values"], dtype=np.float64)  # NaN where nothing is known; the rest are whole numbers below 2**53
    factor = max(1, int(np.fmax.reduce(np.abs(cells), axis=None, initial=0.0)) // levels)
    return {"resolution": packed["resolution"] * factor, "differences": _differences((2.0 * cells + factor) // (2.0 * factor))}


def _differences(cells: NDArray[np.float64]) -> list[Any]:
    numbers = ~np.isnan(cells)
    if numbers.all():
        return list(np.diff(cells, prepend=0.0).astype(np.int64).tolist())
    if cells.ndim > 1:
        return [_differences(row) for row in cells]
    steps = np.full(cells.shape, None, dtype=object)
    steps[numbers] = np.diff(cells[numbers], prepend=0.0).astype(np.int64)
    return list(steps.tolist())
