"""Profiles inside the page: compressed as in their files, the weather of a task only once."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from glbench.evaluation.profiles import Profile
from glbench.report.collecting import Known

_EMBEDDED = ("seeds", "day", "season", "calendar", "worst", "hours")


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


def profile_blocks(known: Sequence[Known], blocks: Blocks) -> tuple[dict[str, str], dict[str, str]]:
    """Names of the profiles by ``results_digest``, and of the weather by task id."""
    profiles, weather = {}, {}
    for item in known:
        if item.profile is None:
            continue
        document = item.profile.document
        profiles[item.row.results_digest] = blocks.add("profile", {key: document[key] for key in _EMBEDDED})
        if item.row.task_id not in weather:
            weather[item.row.task_id] = blocks.add("weather", document["weather"] | _clock(item.profile))
    return profiles, weather


def _clock(profile: Profile) -> dict[str, Any]:
    return {"slot_seconds": profile.document["day"]["slot_seconds"]}
