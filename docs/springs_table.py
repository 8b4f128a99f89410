"""The table of training.md on springs that a policy has not seen: ``python -m docs.springs_table springs.json``.

``springs.json`` comes from ``pytest benchmarks/test_unseen_springs.py -m slow --benchmark-json=springs.json``. What the table needs is
kept in measurements/springs.json; without a file the table is made from that.
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from docs.tables import with_tables

PAGE = Path(__file__).parent / "training.md"
FILE = Path(__file__).parent / "measurements" / "springs.json"
ROWS = (
    ("differs", "nominal", "`fast.yml`"),
    ("differs", "differs", "`fast.yml`"),
    ("differs", "redrawn", "`fast.yml`"),
    ("sensors", "sensors", "`memory.yml`"),
    ("sensors", "differs", "`memory.yml`"),
    ("default", "default", "`fast.yml`"),
)
"""What a policy learnt in, what it was scored in, and its recipe."""
WHERE = {
    "nominal": "the paper's crop and house, 29 first days",
    "differs": "crop, leaves and house differ by up to 10 %",
    "redrawn": "from 1 March, the crop redrawn at every step",
    "sensors": "they differ, and sensors err",
    "default": "`Schiphol2010-Delta10-v1` as published",
}


def kept(benchmarks: Mapping[str, Any]) -> dict[str, Any]:
    """The ``extra_info`` of each benchmark, by the task that was trained on."""
    return {one["param"].rpartition("-")[2]: one["extra_info"] for one in benchmarks["benchmarks"]}


def filled(page: str, found: Mapping[str, Any]) -> str:
    """The page with the table."""
    lines = [
        "| score in | recipe | three trainings | median | `rule_based_tuned` | `rule_based_fair` | processor time of a training |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for learnt, scored, recipe in ROWS:
        rewards, seconds = found[learnt][scored], found[learnt]["processor_seconds"]
        each = ", ".join(f"{reward:,.0f}" for reward in rewards["ppo"])
        rules = " | ".join(f"{rewards[name]:,.0f}" for name in ("rule_based_tuned", "rule_based_fair"))
        cells = (
            WHERE[scored],
            recipe,
            each,
            f"{statistics.median(rewards['ppo']):,.0f}",
            rules,
            f"{min(seconds):.0f} to {max(seconds):.0f} s",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return with_tables(page, {"springs": "\n".join(lines)})


def read() -> dict[str, Any]:
    """What was measured."""
    found: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Keep, fill."""
    if len(sys.argv) > 1:
        found = kept(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
        FILE.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), read()), encoding="utf-8")


if __name__ == "__main__":
    main()
