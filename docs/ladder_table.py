"""The tables of ladder.md: ``python -m docs.ladder_table [runs/ladder-TASK/ladder.json ...]``.

Files that are named are kept as measurements/ladder-TASK.json, with rounded values of runs; ladders that leave out single sensors as
measurements/ladder-TASK-sensors.json. The page then has a table for each file there.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from docs.tables import with_tables
from glbench.errors import refuse
from glbench.leaderboard.ladder import Ladder, table_cells, table_notes, verdict_lines

PAGE = Path(__file__).parent / "ladder.md"
MEASUREMENTS = Path(__file__).parent / "measurements"
LARGEST = 30_000
"""Most bytes of a ladder that is kept."""


def read() -> list[Ladder]:
    """The ladders that are kept, by the names of their files."""
    return [
        Ladder.model_validate_json(file.read_text(encoding="utf-8"))
        for file in sorted(MEASUREMENTS.glob("ladder-*.json"), key=lambda file: file.stem)
    ]


def _leaves_out(ladder: Ladder) -> bool:
    names = [rung.name for rung in ladder.rungs]
    return "blind" not in names and any(name.startswith("without_") for name in names)


def kept(ladder: Ladder) -> str:
    """What is kept of a ladder: all of it, the values of runs with one decimal more than the table has.

    Raises ``ValueError`` when that is more than ``LARGEST``.
    """
    document = ladder.model_dump(by_alias=True)
    for rung in document["rungs"]:
        rung["values"] = [[round(value, ladder.digits + 1) for value in values] for values in rung["values"]]
    text = json.dumps(document, separators=(",", ":")) + "\n"
    if len(text) > LARGEST:
        refuse(f"The ladder of {ladder.task} has {len(text):,} bytes of at most {LARGEST:,}: keep fewer rungs, trainings or runs.")
    return text


def section(ladder: Ladder) -> str:
    """The table of a ladder, its verdicts, and what it was made with."""
    headings, *rows = table_cells(ladder)
    lines = [f"| {' | '.join(cells)} |" for cells in (headings, ["---"] * len(headings), *rows)]
    made = (
        f"{len(ladder.seeds)} runs of the {ladder.split} split (seeds {ladder.seeds[0]} to {ladder.seeds[-1]}), "
        f"{ladder.trained}, task digest `{ladder.task_digest[:12]}`. {table_notes(ladder)}"
    )
    verdicts = [f"- {line}" for line in verdict_lines(ladder)]
    title = ladder.task.rpartition("/")[2] + (": the price of each sensor" if _leaves_out(ladder) else "")
    return "\n".join([f"### {title}", "", *lines, "", made, "", *verdicts]).rstrip()


def filled(page: str, ladders: Sequence[Ladder]) -> str:
    """The page with the tables."""
    return with_tables(page, {"ladders": "\n\n".join(map(section, ladders)) or "No ladder is published yet."})


def main() -> None:
    """Keep, fill."""
    for name in sys.argv[1:]:
        ladder = Ladder.model_validate_json(Path(name).read_text(encoding="utf-8"))
        name = f"ladder-{ladder.task.rpartition('/')[2]}{'-sensors' if _leaves_out(ladder) else ''}.json"
        (MEASUREMENTS / name).write_text(kept(ladder), encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), read()), encoding="utf-8")


if __name__ == "__main__":
    main()
