"""The profile of a result: a small file beside it, from which pages show days, seasons and hours without simulating."""

from __future__ import annotations

import gzip
import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, FailFast, Field, ValidationError

from glbench.errors import ResultError
from glbench.evaluation.records import Digest
from glbench.fields import Count, Word
from glbench.settings import first_problems
from glbench.untrusted import LARGEST_INTEGER, MIB, gunzip, parse_json, quoted, read_regular, reason_of

SCHEMA: Final = "glbench/profile"
VERSION: Final = 1
SUFFIX: Final = ".profile.json.gz"
_LARGEST_FILE, _LARGEST_CONTENT = 24 * MIB, 24 * MIB
"""That of 30 runs of 60 days has 0.2 MB uncompressed."""
_DEEPEST_TASK = 20
_MOST_RUNS = 10_000


def _shallow(task: dict[str, Any]) -> dict[str, Any]:
    """``task``, whose tables and lists are nested no deeper than those of a task file."""
    level: list[Any] = [task]
    for _ in range(_DEEPEST_TASK):
        inner = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)]
        level = [value for values in inner for value in values]
        if not level:
            return task
    msg = "it is nested too deeply"
    raise ValueError(msg)


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


class _Column(_Part):
    unit: Word
    meaning: Word
    kind: Literal["level", "amount"]


class _WeatherColumn(_Part):
    unit: Word
    meaning: Word


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
    """Read a profile file.

    Raises
    ------
    ResultError
        When it is missing, damaged, or of another kind or version.
    """
    try:
        document = parse_json(gunzip(read_regular(path, _LARGEST_FILE), _LARGEST_CONTENT))
    except (OSError, EOFError, zlib.error, ValueError) as error:
        msg = f"Cannot read the profile {path}: {reason_of(error)}. Make it again with `glbench report --complete`."
        raise ResultError(msg) from error
    kind = (document.get("schema"), document.get("schema_version")) if isinstance(document, dict) else None
    if kind != (SCHEMA, VERSION):
        msg = f"{path} is no profile that this glbench reads (schema {quoted(kind)}, expected {(SCHEMA, VERSION)})."
        raise ResultError(msg)
    try:
        _Document.model_validate(document)
    except ValidationError as error:
        msg = f"{path} is no profile as glbench writes it ({first_problems(error)}). Delete it and run `glbench report --complete`."
        raise ResultError(msg) from error
    return Profile(document)
