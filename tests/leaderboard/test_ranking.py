"""Ranks, refusals and tables, on made-up results."""

from __future__ import annotations

import pandas as pd
import pytest

from glbench.errors import GlbenchError, ResultError
from glbench.leaderboard import Expectation, collect_results, rank, to_frame, to_markdown, write_leaderboard
from tests.leaderboard.synthetic import TASK, digest_of

SEEDS = tuple(range(666, 670))


def published():
    return {TASK: Expectation(digest=digest_of("meadow"), seeds=SEEDS)}


def test_the_highest_mean_reward_comes_first(store):
    stored = [store("low", [-9.0, -8.0, -7.0, -6.0]), store("high", [5.0, 6.0, 7.0, 8.0])]
    (table,) = rank(stored, published())
    assert [(row.rank, row.agent) for row in table.rows] == [(1, "high"), (2, "low")]
    assert table.rows[0].estimates["reward"].mean == 6.5
    assert table.rows[0].estimates["reward"].iqm == 6.5
    assert table.rows[0].estimates["reward"].low < 6.5 < table.rows[0].estimates["reward"].high


def test_agents_that_cannot_be_told_apart_share_a_rank_and_the_next_rank_is_left_out(store):
    stored = [store(name, [1.0, 2.0, 3.0, 4.0]) for name in ("b", "a")] + [store("c", [-19.0, -18.0, -17.0, -16.0])]
    (table,) = rank(stored, published())
    assert [(row.rank, row.agent) for row in table.rows] == [(1, "a"), (1, "b"), (3, "c")]


def test_a_result_with_fewer_runs_is_shown_without_a_rank(store):
    stored = [store("whole", [1.0, 2.0, 3.0, 4.0]), store("quick", [9.0, 9.0])]
    (table,) = rank(stored, published())
    assert [(row.rank, row.agent) for row in table.rows] == [(1, "whole"), (None, "quick")]
    assert "2 of 4 runs" in table.rows[1].remark


def test_a_result_with_chosen_seeds_is_shown_without_a_rank(store):
    stored = [store("whole", [1.0, 2.0, 3.0, 4.0]), store("lucky", [9.0] * 4, first_seed=1)]
    (table,) = rank(stored, published())
    assert table.rows[1].agent == "lucky"
    assert table.rows[1].rank is None
    assert "other seeds" in table.rows[1].remark


def test_a_users_own_task_is_ranked_over_its_largest_set_of_seeds(store):
    (table,) = rank([store("whole", [1.0, 2.0, 3.0]), store("quick", [9.0])], {})
    assert [(row.rank, row.agent) for row in table.rows] == [(1, "whole"), (None, "quick")]


def test_failed_runs_are_counted_in_the_row(store):
    (table,) = rank([store("fragile", [1.0, 2.0, -300.0, -300.0], crashed=2)], published())
    assert table.rows[0].failed == 2
    assert table.rows[0].estimates["reward"].mean == pytest.approx(-149.25)
    assert "4 (2 failed)" in to_markdown([table], {})


def test_results_of_another_version_of_a_published_task_are_refused_by_name(store):
    stale = store("old", [1.0] * 4, task_digest=digest_of("meadow, mown"))
    with pytest.raises(ResultError, match=r"old\.json is not of 'glbench/Meadow-v1' as it is published"):
        rank([stale, store("new", [1.0] * 4)], published())


def test_results_of_two_definitions_of_a_users_task_are_refused(store):
    with pytest.raises(ResultError, match="is of another version of 'glbench/Meadow-v1'"):
        rank([store("a", [1.0]), store("b", [1.0], task_digest=digest_of("other"))], {})


def test_collecting_prefers_the_first_folder_and_ignores_missing_ones(store, tmp_path):
    store("same", [1.0] * 4, folder="released")
    store("only_released", [2.0] * 4, folder="released")
    store("same", [5.0] * 4, folder="mine")
    found = collect_results([tmp_path / "absent", tmp_path / "mine", tmp_path / "released"])
    assert [(item.result.agent.name, item.result.summary.mean["reward"]) for item in found] == [("only_released", 2.0), ("same", 5.0)]


def test_two_results_of_one_agent_in_one_folder_are_refused(store, tmp_path):
    stored = store("twin", [1.0] * 4)
    copy = stored.path.with_name("copy.json")
    copy.write_bytes(stored.path.read_bytes())
    with pytest.raises(ResultError, match="is a second result of 'twin'"):
        collect_results([tmp_path])


def test_a_reward_changed_by_hand_is_refused(store, tmp_path):
    stored = store("honest", [1.0, 2.0, 3.0, 4.0])
    stored.path.write_text(stored.path.read_text().replace('"reward": 4.0', '"reward": 400.0'))
    with pytest.raises(ResultError, match=r"honest\.json"):
        collect_results([tmp_path])


def test_markdown_carries_units_intervals_and_the_privileged_mark(store):
    tables = rank([store("rule", [-1.0, 0.0, 1.0, 2.0], privileged=True)], published())
    text = to_markdown(tables, {})
    assert "EPI [EUR/m²]" in text
    assert "| 1 | rule † | 0.5 [" in text
    assert "privileged" in text


def test_suite_overview_sets_tasks_side_by_side(store):
    ids = ["glbench/Meadow-v1", "glbench/Field-v1"]
    stored = [store("a", [1.0, 3.0], task_id=i) for i in ids] + [store("b", [7.0, 9.0], task_id=ids[0])]
    text = to_markdown(rank(stored, {}), {"outdoors": ids})
    assert "| Reward, mean | Meadow-v1 | Field-v1 |" in text
    assert "| a | 2.0 | 2.0 |" in text
    assert "| b | 8.0 | – |" in text


def test_files_hold_the_same_numbers_in_csv_and_parquet(store, tmp_path):
    tables = rank([store("a", [1.0, 2.5, 3.0, 4.0]), store("b", [2.0, 2.0])], published())
    write_leaderboard(tables, {}, tmp_path / "out")
    csv = pd.read_csv(tmp_path / "out" / "leaderboard.csv", dtype={"rank": "Int64"})
    parquet = pd.read_parquet(tmp_path / "out" / "leaderboard.parquet")
    assert list(csv["rank"].fillna(0)) == [1, 0]
    assert list(csv["reward_mean [-]"]) == list(parquet["reward_mean [-]"]) == [2.625, 2.0]
    assert "epi_low [EUR m-2]" in csv.columns
    assert to_frame(tables).equals(parquet)


def test_writing_twice_gives_the_same_bytes(store, tmp_path):
    tables = rank([store("a", [1.0, 2.5, 3.0, 4.0])], published())
    first = [path.read_bytes() for path in write_leaderboard(tables, {}, tmp_path / "out")]
    assert first == [path.read_bytes() for path in write_leaderboard(tables, {}, tmp_path / "out")]


def test_a_file_in_the_way_of_the_folder_is_said(store, tmp_path):
    (tmp_path / "blocked").write_text("a file")
    with pytest.raises(GlbenchError, match="Cannot write"):
        write_leaderboard(rank([store("a", [1.0])], {}), {}, tmp_path / "blocked")


def test_runs_that_are_all_alike_have_no_interval(store):
    text = to_markdown(rank([store("sure", [2.0] * 4)], published()), {})
    assert "| 1 | sure | 2.0 | 0.002 |" in text


@pytest.mark.parametrize("sandbox", ["unsandboxed", None])
def test_a_submission_that_ran_without_a_sandbox_is_marked(store, sandbox):
    tables = rank([store("free", [2.0] * 4, sandbox=sandbox), store("held", [-21.0] * 4)], published())
    text = to_markdown(tables, {})
    assert "| 1 | free ‡ | 2.0" in text
    assert "| 2 | held | -21.0" in text
    assert [row.unsandboxed for row in tables[0].rows] == [True, False]
