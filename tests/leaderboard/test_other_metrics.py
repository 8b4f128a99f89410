"""Results of other versions: metrics that this one does not know are shown by name, those that a result lacks are a dash."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from glbench.errors import ResultError
from glbench.leaderboard import Expectation, StoredResult, rank, to_frame, to_markdown, write_leaderboard
from glbench.leaderboard.catalogue import catalogue, pretty_unit
from glbench.leaderboard.entries import entry_of
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.suites import scores_by_task, suite_table
from glbench.leaderboard.tables import suite_frame, suite_markdown, to_json, to_latex
from glbench.tasks.references import References
from tests.leaderboard.synthetic import TASK, digest_of, of_another_version

EXPECTED = {TASK: Expectation(digest_of("meadow"), tuple(range(666, 670)))}


@pytest.fixture
def mixed(store):
    """A result of this version, one that knows of gas and nothing of heat and CO2, and one without a reward."""

    def other(agent: str, level: float, lacks: tuple[str, ...]) -> StoredResult:
        item = store(agent, [level + i for i in range(4)])
        return replace(item, result=of_another_version(item.result, lacks, {"gas": ("m3 m-2", 1.5)}))

    usual = store("usual", [50.0, 51.0, 52.0, 53.0])
    return [usual, other("gassy", 10.0, ("heat", "co2", "epi")), other("scoreless", 90.0, ("reward",))]


def test_tables_show_a_dash_for_what_a_result_lacks(mixed):
    (table,) = rank(mixed, EXPECTED)
    assert [(row.agent, row.rank) for row in table.rows] == [("usual", 1), ("gassy", 2), ("scoreless", None)]
    assert table.rows[2].remark == "not ranked: the result does not state 'reward'"
    line = next(line for line in to_markdown([table], {}).splitlines() if "| gassy |" in line)
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert (cells[3], cells[6], cells[8]) == ("–", "–", "–"), "EPI, heat and CO2"
    assert "–" in next(line for line in to_markdown([table], {}).splitlines() if "| scoreless |" in line)
    assert any(line.startswith("2 & gassy & 11.5 ") and " & -- & " in line for line in to_latex(table).splitlines())


def test_programs_get_unknown_metrics_by_their_names_and_units(mixed, tmp_path):
    tables = rank(mixed, EXPECTED)
    frame = to_frame(tables).set_index("agent")
    assert frame.loc["gassy", "gas_mean [m3 m-2]"] == 1.5
    assert frame["gas_mean [m3 m-2]"].isna().to_list() == [True, False, False]
    assert frame["heat_mean [kWh m-2]"].isna()["gassy"]
    assert frame["entry_reward_lowest [-]"].isna()["scoreless"]
    document = json.loads(to_json(tables))
    assert document["units"]["gas"] == "m3 m-2"
    assert "heat" not in next(row for row in document["tasks"][0]["rows"] if row["agent"] == "gassy")["metrics"]
    assert write_leaderboard(tables, {}, tmp_path)


def test_suites_average_what_all_tasks_have(mixed):
    references = {
        TASK: References(zero=0.0, zero_agent="do_nothing", zero_results_digest="", best=60.0, best_agent="x", best_results_digest="")
    }
    table = suite_table("s", (TASK,), scores_by_task(mixed, EXPECTED), references, rank(mixed, EXPECTED))
    assert table is not None
    assert [row.agent for row in table.rows] == ["usual", "gassy"]
    assert suite_frame([table])["heat_mean [kWh m-2]"].isna().to_list() == [False, True]
    assert any("| gassy | – |" in line for line in suite_markdown(table))


def test_two_results_are_compared_in_what_both_have(mixed):
    usual, gassy, scoreless = map(entry_of, mixed)
    pair = compare_entries(usual, gassy)
    assert (pair.metrics["heat"].difference, pair.metrics["gas"].first, pair.metrics["gas"].second) == (None, None, 1.5)
    assert pair.gap("reward") == 40.0
    assert "cost_heat" in pair.money
    with pytest.raises(ResultError, match="'scoreless' does not state its reward"):
        compare_entries(usual, scoreless)


def test_units_are_written_as_people_write_them():
    written = {"EUR m-2": "EUR/m²", "mg m-2 s-1": "mg/m²/s", "m3 m-2": "m3/m²", "degC": "°C", "-": "", "h": "h"}
    assert {unit: pretty_unit(unit) for unit in written} == written


def test_a_metric_without_words_is_called_by_its_name():
    metric = catalogue().metric("gas", {"gas": "m3 m-2"})
    assert (metric.label, metric.line, metric.kind, metric.column) == ("gas", "gas", "unknown", False)
