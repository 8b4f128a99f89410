"""Which of the checkout's data goes into which wheel, for the build hooks of both.

``glbench-data`` holds all baselines, all released results and the pictures of glbench.vision. ``glbench`` holds what its commands need
without it: every released result but those of the suites transfer, paper-code and lettuce-classic, and every baseline but large policies
and plans. It also holds the digest of the data that belong to it, and what it lacks of them.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

FOLDERS = {"baselines": "baselines", "reports/released/results": "reports/released/results", "images": "glbench-data/images"}
"""Names of the data folders, and where they are in a checkout."""
LARGEST_POLICY = 90 * 1024
"""Size of a baseline's policies or plans from which on they are only in ``glbench-data`` [bytes]."""
ELSEWHERE = (
    "reports/released/results/Transfer-*",
    "reports/released/results/Schiphol2010Code-*",
    "reports/released/results/LettuceClassic-*",
)
BESIDE = ("*.profile.json.gz", *ELSEWHERE, "images/*")
"""Files of results that are only in ``glbench-data``: profiles, from which the report draws days, the suites transfer,
paper-code and lettuce-classic (``ELSEWHERE``), and pictures."""


def whole(root: Path) -> dict[str, Path]:
    """All files of the data by their names in the package, in order."""
    files = ((name, root / place, file) for name, place in FOLDERS.items() for file in (root / place).rglob("*") if file.is_file())
    kept = (entry for entry in files if "__pycache__" not in entry[2].parts and entry[2].suffix != ".mcap")
    return dict(sorted((f"{name}/{file.relative_to(folder).as_posix()}", file) for name, folder, file in kept))


def digest(files: dict[str, Path]) -> str:
    """SHA-256 (hex) over names and contents."""
    total = hashlib.sha256()
    for name, file in files.items():
        for part in (name.encode(), file.read_bytes()):
            total.update(len(part).to_bytes(8, "big") + part)
    return total.hexdigest()


def part(root: Path) -> tuple[dict[str, Path], dict[str, Any]]:
    """What of it ``glbench`` holds, and what it says of the whole.

    That is the version, the SHA-256, the baselines left out with their digests, and the tasks whose results are left out.
    """
    files = whole(root)
    large = {}
    for card in sorted((root / "baselines").glob("*/card.toml")):
        settings = (card.parent / tomllib.loads(card.read_text(encoding="utf-8"))["settings"]).resolve()
        own = {name for name, file in files.items() if file.resolve().is_relative_to(settings)}
        if sum(files[name].stat().st_size for name in own) > LARGEST_POLICY:
            large[card.parent.name] = own
    beside = {name for names in large.values() for name in names}
    beside |= {name for name in files if any(fnmatch(name, pattern) for pattern in BESIDE)}
    kept = {name: file for name, file in files.items() if name not in beside}
    facts = {
        "version": _version(root),
        "sha256": digest(files),
        "left_out": {name: _agent_digest(root, name) for name in large},
        "tasks": sorted({Path(name).parts[3] for name in beside if any(fnmatch(name, pattern) for pattern in ELSEWHERE)}),
    }
    return kept, facts


def _version(root: Path) -> str:
    project: dict[str, Any] = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project["version"])


def _agent_digest(root: Path, name: str) -> str:
    """Digest of a baseline: that of the lock, which also knows all that its released results state."""
    entry: dict[str, Any] = tomllib.loads((root / "baselines/lock.toml").read_text(encoding="utf-8")).get(name, {})
    results = (root / "reports/released/results").glob(f"*/{name}.json")
    stated = {json.loads(file.read_bytes())["agent"]["digest"] for file in results}
    if not stated or not stated <= {entry.get("digest"), *entry.get("earlier", [])}:
        msg = f"Released results of '{name}' state digests that baselines/lock.toml does not have. Release it again (baselines/release.py)."
        raise ValueError(msg)
    return str(entry["digest"])
