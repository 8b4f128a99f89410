"""The tables of ladder.md: ``python -m docs.ladder_table [runs/ladder-TASK/ladder.json ...]``.

Files that are named are copied to measurements/ladder-TASK.json; the page then has a table for each file there.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from docs.tables import with_tables
from glbench.leaderboard.ladder import Ladder, table_cells, verdict_words

PAGE = Path(__file__).parent / "ladder.md"
MEASUREMENTS = Path(__file__).parent / "measurements"


def read() -> list[Ladder]:
    """The ladders that are kept, by the names of their files."""
    return [Ladder.model_validate_json(file.read_text(encoding="utf-8")) for file in sorted(MEASUREMENTS.glob("ladder-*.json"))]


def section(ladder: Ladder) -> str:
    """The table of a ladder, its verdicts, and what it was made with."""
    headings, *rows = table_cells(ladder)
    lines = [f"| {' | '.join(cells)} |" for cells in (headings, ["---"] * len(headings), *rows)]
    made = (
        f"{len(ladder.seeds)} runs of the {ladder.split} split (seeds {ladder.seeds[0]} to {ladder.seeds[-1]}), trainings of "
        f"{ladder.steps:,} steps, task digest `{ladder.task_digest[:12]}`. In brackets: 95 % intervals over scenarios and trainings."
    )
    verdicts = [f"- {verdict_words(verdict, ladder)}" for verdict in ladder.verdicts]
    return "\n".join([f"### {ladder.task.rpartition('/')[2]}", "", *lines, "", made, "", *verdicts]).rstrip()


def filled(page: str, ladders: Sequence[Ladder]) -> str:
    """The page with the tables."""
    return with_tables(page, {"ladders": "\n\n".join(map(section, ladders)) or "No ladder is published yet."})


def main() -> None:
    """Keep, fill."""
    for name in sys.argv[1:]:
        text = Path(name).read_text(encoding="utf-8")
        task = Ladder.model_validate_json(text).task.rpartition("/")[2]
        (MEASUREMENTS / f"ladder-{task}.json").write_text(text, encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), read()), encoding="utf-8")


if __name__ == "__main__":
    main()
