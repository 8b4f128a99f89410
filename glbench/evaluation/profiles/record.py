"""The profile of a result: a small file beside it, from which pages show days, seasons and hours without simulating."""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, FailFast, Field, ValidationError

from glbench.errors import ResultError, refuse
from glbench.evaluation.records import Digest
from glbench.fields import Count, Word
from glbench.settings import first_problems
from glbench.untrusted import LARGEST_INTEGER, MIB, gunzip, parse_json, quoted, read_regular, reason_of

SCHEMA: Final = "glbench/profile"
VERSION: Final = 1
SUFFIX: Final = ".profile.json.gz"
_LARGEST_FILE, _LARGEST_CONTENT = 24 * MIB, 24 * MIB  # That of 30 runs of 60 days has 0.2 MB uncompressed
_DEEPEST_TASK = 20
_MOST_RUNS = 10_000


def _shallow(task: dict[str, Any]) -> dict[str, Any]:
    """``task``, whose tables and lists are nested no deeper than those of a task file."""
    level: list[Any] = [task]
    for _ in range(_DEEPEST_TASK):
        inner = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)]
        level = [value for values in inner for value in values]
        if not level:
            break
    else:
        refuse("it is nested too deeply")
    return task


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


_Cell = Annotated[int, Field(ge=-LARGEST_INTEGER, le=LARGEST_INTEGER)] | None
_Cells = Annotated[list[_Cell], FailFast()]


class _Line(_Part):
    resolution: Annotated[float, Field(gt=0, le=1e100)]
    values: _Cells


class _Lines(_Part):
    resolution: Annotated[float, Field(gt=0, le=1e100)]
    values: Annotated[list[_Cells], FailFast()]


class _WeatherColumn(_Part):
    unit: Word
    meaning: Word


class _Column(_WeatherColumn):
    kind: Literal["level", "amount"]


class _Seeds(_Part):
    all: Annotated[list[Count], FailFast()]
    best: Count
    worst: Count
    starts: list[Word] | None = Field(default=None, max_length=_MOST_RUNS)
    """First days of the runs, where they differ."""


class _Day(_Part):
    slot_seconds: Annotated[float, Field(gt=0, le=86400)]
    quantiles: Annotated[list[float], FailFast()]
    columns: dict[Word, _Lines]


class _Season(_Part):
    lines: Annotated[list[Word], FailFast()]
    columns: dict[Word, _Lines]


class _Weather(_Part):
    columns: dict[Word, _WeatherColumn]
    day: dict[Word, _Lines]
    season: _Season
    hours: dict[Word, _Line]


class _Energy(_Part):
    columns: dict[Word, _Line]
    prices: dict[Word, _Line]


class _Document(_Part):
    """What a profile holds: nothing else is handed to pages."""

    schema_name: Annotated[str, Field(alias="schema")]
    schema_version: int
    results_digest: Digest
    task: Annotated[dict[str, Any], AfterValidator(_shallow)]
    columns: dict[Word, _Column]
    seeds: _Seeds
    weather: _Weather
    day: _Day
    season: _Season
    calendar: dict[Word, _Lines]
    worst: dict[Word, _Line]
    hours: dict[Word, _Lines]
    energy: _Energy | None = None
    pictures: list[Count] | None = None
    """Scenes of a library in the last picture on the first day of each week of the worst run."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Content of a profile; ``docs/report.md`` names its keys. ``digest`` is the SHA-256 of its JSON, however it is compressed."""

    document: Mapping[str, Any]

    @property
    def text(self) -> bytes:
        """The JSON: keys in order, no spaces."""
        return json.dumps(self.document, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()

    @property
    def text_of_task(self) -> bytes:
        """The definition of the task as JSON, as records of episodes hold it."""
        return json.dumps(self.document["task"]).encode()

    @property
    def digest(self) -> str:
        """SHA-256 of ``text``."""
        return hashlib.sha256(self.text).hexdigest()

    def to_bytes(self) -> bytes:
        """The file: ``text``, compressed by gzip without name and time, so that the same profile has the same bytes."""
        return gzip.compress(self.text, compresslevel=9, mtime=0)


def profile_path(result: Path) -> Path:
    """``<agent>.profile.json.gz`` beside ``<agent>.json``."""
    return result.with_name(result.name.removesuffix(".json") + SUFFIX)


def read_profile(path: Path) -> Profile:
    """Read a profile file. Raises ``ResultError`` when it is missing, damaged, or of another kind or version."""
    try:
        document = parse_json(gunzip(read_regular(path, _LARGEST_FILE), _LARGEST_CONTENT))
    except (OSError, EOFError, zlib.error, ValueError) as error:
        refuse(f"Cannot read the profile {path}: {reason_of(error)}. Delete it and run `glbench report --complete`.", ResultError, error)
    kind = (document.get("schema"), document.get("schema_version")) if isinstance(document, dict) else None
    if kind != (SCHEMA, VERSION):
        refuse(f"{path} is no profile that this glbench reads (schema {quoted(kind)}, expected {(SCHEMA, VERSION)}).", ResultError)
    try:
        _Document.model_validate(document)
    except ValidationError as error:
        msg = f"{path} is no profile as glbench writes it ({first_problems(error)}). Delete it and run `glbench report --complete`."
        raise ResultError(msg) from error
    return Profile(document)


Floats = NDArray[np.floating]
Cells: TypeAlias = "list[int | None] | list[Cells]"
Packed = dict[str, "float | Cells"]

QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)
SHORTEST_SLOT = 900.0  # Time of day is cut into slots of at least this length [s]
SECONDS_A_DAY = 86400
_MISSING = math.inf


def steps_a_slot(step_seconds: float) -> int:
    """Control steps that make up one slot of the day: the smallest number that divides the day and lasts long enough."""
    a_day = round(SECONDS_A_DAY / step_seconds)
    return next(k for k in range(1, a_day + 1) if a_day % k == 0 and k * step_seconds >= SHORTEST_SLOT)


def typical_day(values: Floats, lengths: NDArray[np.int64], a_day: int, a_slot: int) -> Floats:
    """Quantiles ``(quantiles, slots)`` over all days and runs, from ``values`` ``(steps, n)``; infinite where nothing is known."""
    steps, n = values.shape
    simulated = np.where(np.arange(steps)[:, None] < lengths, values, np.float32(_MISSING))
    slots = simulated.reshape(steps // a_day, a_day // a_slot, a_slot, n).swapaxes(0, 1).reshape(a_day // a_slot, -1)
    slots.sort(axis=1)
    counts = np.isfinite(slots).sum(axis=1)
    return np.take_along_axis(slots, np.array([np.maximum(np.ceil(q * counts).astype(int) - 1, 0) for q in QUANTILES]).T, axis=1).T


def by_day(values: Floats, lengths: NDArray[np.int64], a_day: int, *, add: bool) -> Floats:
    """Sums or means ``(days, n)`` of every day; infinite for days that a run did not end."""
    steps, n = values.shape
    days = values.reshape(steps // a_day, a_day, n).sum(axis=1, dtype=np.float64)
    whole = np.arange(1, steps // a_day + 1)[:, None] * a_day <= lengths
    return np.where(whole, days if add else days / a_day, _MISSING)


def middle_run(days: Floats) -> Floats:
    """Lower median over the runs ``(days,)`` of what they did on each day; infinite where no run ended the day."""
    ordered = np.sort(days, axis=1)
    counts = np.isfinite(ordered).sum(axis=1)
    return np.asarray(np.take_along_axis(ordered, (np.maximum(counts - 1, 0) // 2)[:, None], axis=1)[:, 0])


def by_hour(values: Floats, length: int, step_seconds: float, *, add: bool) -> Floats:
    """Sums or means ``(hours,)`` of one run's ``values`` ``(steps,)``; infinite for hours that did not end."""
    starts = _hour_starts(len(values), step_seconds)
    counts = np.diff(np.append(starts, len(values)))
    sums = np.add.reduceat(values.astype(np.float64), starts)
    return np.where(starts + counts <= length, sums if add else sums / counts, _MISSING)


def by_hour_of_day(values: Floats, a_day: int, step_seconds: float) -> Floats:
    """What every run ``(24, n)`` summed up in each hour of the day, over all days."""
    steps, n = values.shape
    of_day = values.reshape(steps // a_day, a_day, n).sum(axis=0, dtype=np.float64)
    return np.asarray(np.add.reduceat(of_day, _hour_starts(a_day, step_seconds), axis=0))


def calendar(outside: NDArray[np.bool_], lengths: NDArray[np.int64], a_day: int, step_seconds: float) -> Floats:
    """Mean over the runs of the minutes outside a limit ``(days, 24)``; infinite where no run was."""
    steps, _ = outside.shape
    running = np.arange(steps)[:, None] < lengths
    counts = running.sum(axis=1)
    share = (outside & running).sum(axis=1) / np.maximum(counts, 1)
    minutes = np.where(counts > 0, share * step_seconds / 60.0, _MISSING)
    return np.add.reduceat(minutes.reshape(steps // a_day, a_day), _hour_starts(a_day, step_seconds), axis=1)


def pack(values: Floats, digits: int) -> Packed:
    """Whole numbers times a ``resolution``: as many decimals as the largest value needs for ``digits`` after its first digit."""
    finite = np.isfinite(values)
    largest = float(np.abs(values[finite]).max(initial=0.0))
    power = math.floor(math.log10(largest)) - digits if largest > 0 else 0
    cells = np.rint(np.where(finite, values, 0.0).astype(np.float64) * 10.0**-power).astype(np.int64).astype(object)
    cells[~finite] = None
    return {"resolution": 10.0**power, "values": cells.tolist()}


def unpack(packed: Packed) -> NDArray[np.float64]:
    """The numbers of ``pack``, not a number where nothing is known."""
    values = np.array(packed["values"], dtype=np.float64)
    resolution = packed["resolution"]
    assert isinstance(resolution, float)
    return values * resolution


def hours(steps: int, step_seconds: float) -> int:
    """Hours that a step begins in."""
    return len(_hour_starts(steps, step_seconds))


def _hour_starts(steps: int, step_seconds: float) -> NDArray[np.intp]:
    """First step of each hour that a step begins in."""
    return np.flatnonzero(np.diff(np.floor_divide(np.arange(steps) * step_seconds, 3600.0), prepend=-1.0))
