"""The profile of a result: a small file beside it, from which pages show days, seasons and hours without simulating."""

from __future__ import annotations

import gzip
import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from glbench.errors import ResultError

SCHEMA: Final = "glbench/profile"
VERSION: Final = 1
SUFFIX: Final = ".profile.json.gz"


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
        document = json.loads(gzip.decompress(path.read_bytes()))
    except (OSError, EOFError, zlib.error, ValueError) as error:
        msg = f"Cannot read the profile {path}: {error}. Make it again with `glbench report --complete`."
        raise ResultError(msg) from error
    kind = (document.get("schema"), document.get("schema_version")) if isinstance(document, dict) else None
    if kind != (SCHEMA, VERSION):
        msg = f"{path} is no profile that this glbench reads (schema {kind}, expected {(SCHEMA, VERSION)})."
        raise ResultError(msg)
    return Profile(document)
