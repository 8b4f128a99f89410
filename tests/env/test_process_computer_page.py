"""docs/process-computer.md: its tables are what the code says, and the settings page is what it links to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from glbench.tasks.set_points import WORKED, set_points
from glbench.tasks.tables import ProcessComputerTable

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "process-computer.md").read_text(encoding="utf-8")


def rows(columns: int) -> Iterator[list[str]]:
    """Cells of the rows that have so many of them and begin with a name."""
    for line in PAGE.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| `") and len(cells) == columns:
            yield cells


def test_the_set_points_are_those_of_the_code() -> None:
    told = list(rows(6))
    assert [[row[0].strip("`"), row[1], float(row[2]), float(row[3]), row[5]] for row in told] == [
        [action.name, action.unit, action.lowest, action.highest, action.meaning] for action in set_points(WORKED)
    ]
    for name, *_, needs, _ in told:
        for control in re.findall(r"`(\w+)`", needs):
            assert name.strip("`") in {action.name for action in set_points((control,))}


def test_what_it_converts_is_what_an_action_gives() -> None:
    heating, told = (set_points(WORKED)[0], dict(re.findall(r"^heating\.(\w+\([\d.]+\))  # ([\d.]+):", PAGE, re.MULTILINE)))
    assert {call: float(value) for call, value in told.items()} == {
        "of(18.0)": pytest.approx(heating.of(18.0)),
        "value(0.2)": pytest.approx(heating.value(0.2)),
    }


def test_the_settings_are_those_of_the_code() -> None:
    told = {row[0].strip("`"): (float(row[1]), row[2]) for row in rows(4)}
    defaults = ProcessComputerTable().model_dump()
    assert {name: value for name, (value, _) in told.items()} == defaults
    for name, (value, unit) in told.items():
        given = value if unit == "-" else {"value": value, "unit": unit}
        assert ProcessComputerTable.model_validate({name: given}) == ProcessComputerTable()


def test_what_it_links_to_is_there() -> None:
    for target in re.findall(r"\]\(([^)]+)\)", PAGE):
        assert (DOCS / target.partition("#")[0]).is_file(), target
