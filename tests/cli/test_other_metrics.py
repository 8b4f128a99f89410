"""Results of other versions in the terminal: unknown metrics by their names, missing ones as a dash."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.cli import console, results
from glbench.leaderboard import StoredResult, rank
from glbench.leaderboard.catalogue import catalogue
from tests.cli.command_line import Command
from tests.leaderboard.synthetic import make_result, of_another_version

OTHER = of_another_version(make_result("other", [10.0, 11.0]), ("heat", "epi", "cost_heat"), {"gas": ("m3 m-2", 1.5)})
USUAL = make_result("usual", [50.0, 52.0])


@pytest.fixture
def stored(monkeypatch: pytest.MonkeyPatch) -> list[StoredResult]:
    """The two results, as if they were all that is stored."""
    found = [StoredResult(Path(f"{one.agent.name}.json"), one) for one in (USUAL, OTHER)]
    monkeypatch.setattr("glbench.leaderboard.collect.own_and_released_results", lambda _out: (tuple(found), ()))
    monkeypatch.setenv("COLUMNS", "160")
    console.output.cache_clear()
    yield found
    console.output.cache_clear()


def row(text: str, name: str) -> list[str]:
    """Cells of the first line that begins with a name."""
    line = next(line for line in text.splitlines() if line.replace("│", " ").split()[:1] == [name])
    return line.replace("│", " ").split()


def test_show(glbench: Command, stored: list[StoredResult]) -> None:
    done = glbench("show", "other", "--all")
    assert done.code == 0, done.err
    assert row(done.out, "Heat") == ["Heat", "kWh/m²", "–", "–", "–"]
    assert row(done.out, "gas")[:3] == ["gas", "m3/m²", "1.50"]
    assert "Worst run: seed 666, reward 10.0\n" in done.out


def test_compare(glbench: Command, stored: list[StoredResult]) -> None:
    done = glbench("compare", "usual", "other")
    assert done.code == 0, done.err
    assert row(done.out, "Heat")[:6] == ["Heat", "kWh/m²", "0.05", "–", "–", "–"]
    assert row(done.out, "gas")[:6] == ["gas", "m3/m²", "–", "1.50", "–", "–"]
    assert glbench("compare", "usual", "other", "--json").code == 0


def test_leaderboard(glbench: Command, stored: list[StoredResult]) -> None:
    done = glbench("leaderboard", "--task", "Meadow-v1")
    assert done.code == 0, done.err
    (table,) = rank(stored, {})
    assert [(one.agent, one.rank) for one in table.rows] == [("usual", 1), ("other", 2)]
    assert "–" in row(done.out.partition("Harvest, resources")[2], "other"), "its heat"
    assert '"gas_mean [m3 m-2]": 1.5' in glbench("leaderboard", "--task", "Meadow-v1", "--json").out


def test_a_row_with_failed_runs_is_marked_also_where_no_column_says_so(
    glbench: Command, stored: list[StoredResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    stored.append(StoredResult(Path("failing.json"), make_result("failing", [40.0, 41.0], crashed=1)))
    monkeypatch.setenv("COLUMNS", "60")
    console.output.cache_clear()
    done = glbench("leaderboard", "--task", "Meadow-v1")
    assert done.code == 0, done.err
    assert "Hidden columns (terminal too narrow):" in done.out
    names = {line.split()[1]: line.split()[2] for line in done.out.splitlines() if line.split()[:1] in (["1"], ["2"])}
    assert names["failing"] == "✗"
    assert names["usual"] != "✗"
    assert "✗ some runs failed: they count at the task's stated penalty." in " ".join(done.out.split())


def test_money_is_shown_as_far_as_it_is_known() -> None:
    lines = results.money_lines(OTHER, catalogue())
    assert [line.split()[0] for line in lines] == ["fruit", "lamps", "CO2"]
