"""Boards that are kept apart by salt and split, and rows of agents that were trained on what they are judged by."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from glbench.agents.card import check_card
from glbench.cli.options import tables_by_name
from glbench.errors import ResultError
from glbench.evaluation.records import Result
from glbench.leaderboard import rank, to_frame, to_markdown
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.tables import footnotes, to_json, to_latex
from tests.leaderboard.synthetic import TASK, digest_of, make_entry, make_result

SALT, OTHER = digest_of("salt"), digest_of("other salt")
REWARDS = [float(i) for i in range(10)]
TEST = {"split": "test", "years": (2011, 2012)}
HEAD = 'name = "a"\nauthors = ["b"]\nlicence = "MIT"\ninformation = ["observations"]\n[training]\n'


def test_results_under_different_salts_stand_on_different_boards_that_say_so(store):
    stored = [
        store("a", REWARDS, **TEST),
        store("a", REWARDS, "one", salt_commitment=SALT, **TEST),
        store("b", REWARDS, "one", salt_commitment=SALT, **TEST),
        store("a", REWARDS, "two", salt_commitment=OTHER, **TEST),
    ]
    tables = {table.task_id: table for table in rank(stored, {})}
    sealed = f"{TASK}@{SALT}"
    assert set(tables) == {TASK, sealed, f"{TASK}@{OTHER}"}
    assert {row.agent for row in tables[sealed].rows} == {"a", "b"}
    assert tables[sealed].draws == f"sealed draws, salt commitment {SALT}"
    assert tables[TASK].draws == ""
    page = to_markdown(list(tables.values()), {})
    assert page.count("## A meadow") == 3
    assert f"(sealed draws, salt commitment {OTHER})" in page
    assert f"salt commitment {SALT}" in to_latex(tables[sealed])
    assert {(one["id"], one["task"], one["salt_commitment"]) for one in json.loads(to_json([tables[sealed]]))["tasks"]} == {
        (sealed, TASK, SALT)
    }


def test_commitments_that_begin_alike_have_separate_boards(store):
    alike = SALT[:16] + "0" * 48
    tables = {table.task_id: table for table in rank([store("a", REWARDS, salt_commitment=one, **TEST) for one in (SALT, alike)], {})}
    assert set(tables) == {f"{TASK}@{SALT}", f"{TASK}@{alike}"}
    short = f"{TASK}@{SALT[:16]}"
    assert short not in tables_by_name([*tables.values()])
    honest = tables[f"{TASK}@{SALT}"]
    assert tables_by_name([honest])[short] is honest


def test_results_under_different_salts_are_not_compared():
    with pytest.raises(ResultError, match="not the same draws"):
        compare_entries(make_entry("a", REWARDS, salt_commitment=SALT), make_entry("b", REWARDS))


def test_the_validation_split_has_a_board_of_its_own(store):
    stored = [store("a", REWARDS, **TEST), store("a", REWARDS, "v", split="validation", years=(2008,))]
    tables = {table.task_id: table.draws for table in rank(stored, {})}
    assert tables == {TASK: "", f"{TASK}@validation": "validation split"}


def test_groups_and_a_salt_are_covered_by_the_digest_and_absent_without():
    plain = json.loads(make_result("a", REWARDS).to_json())
    assert "salt_commitment" not in plain["task"]
    assert "cluster" not in plain["runs"][0]
    names = ["2011", "2012"] * 5
    full = json.loads(make_result("a", REWARDS, clusters=names, salt_commitment=SALT, **TEST).to_json())
    for change in (("task", {"salt_commitment": OTHER}), ("runs", None)):
        changed = json.loads(json.dumps(full))
        if change[0] == "task":
            changed["task"] |= change[1]
        else:
            changed["runs"][0]["cluster"] = "2012"
        with pytest.raises(ValidationError, match="results_digest does not match"):
            Result.model_validate_json(json.dumps(changed))
    some = json.loads(json.dumps(full))
    del some["runs"][0]["cluster"]
    with pytest.raises(ValidationError, match="name their group"):
        Result.model_validate_json(json.dumps(some))
    assert Result.model_validate_json(json.dumps(full)).clusters == tuple(names)


@pytest.mark.parametrize("cluster", ["", "a" * 81, "\x1b[2J", "<b>", " "])
def test_the_name_of_a_group_is_short_and_harmless(cluster):
    document = json.loads(make_result("a", REWARDS, clusters=["2011"] * 10).to_json())
    document["runs"][0]["cluster"] = cluster
    with pytest.raises(ValidationError, match="cluster"):
        Result.model_validate_json(json.dumps(document))


@pytest.mark.parametrize(
    ("training", "words"),
    [
        ({"split": "test"}, "was trained on the test split"),
        ({"split": "training", "years": (2010, 2011)}, "was trained on weather of 2011"),
        ({"split": "training", "years": (2008, 2009, 2010)}, ""),
        ({"split": "none"}, ""),
        (None, ""),
    ],
)
def test_a_row_is_marked_when_its_training_saw_what_is_judged(store, training, words):
    (table,) = rank([store("a", REWARDS, training=training, **TEST)], {})
    (row,) = table.rows
    assert row.saw_scored.startswith(words)
    assert bool(row.saw_scored) == bool(words)
    page = to_markdown([table], {})
    assert ("§" in page) == bool(words)
    assert any("§" in note for note in footnotes([table])) == bool(words)
    assert ("\\S" in to_latex(table)) == bool(words)
    if words:
        assert f"§ a {words}" in page


def test_a_task_without_splits_marks_nobody(store):
    (table,) = rank([store("a", REWARDS, training={"split": "test", "years": (2010,)})], {})
    assert table.rows[0].saw_scored == ""


def test_the_row_tells_what_the_training_saw(store):
    told = {"tasks": ("glbench/Spring-v1",), "split": "training", "years": (2008, 2009, 2010)}
    (table,) = rank([store("a", REWARDS, training=told, **TEST), store("b", REWARDS, **TEST)], {})
    words = {row.agent: row.trained_on.words for row in table.rows}
    assert words == {"a": "Spring-v1, training split, 2008 to 2010", "b": "unknown"}
    assert list(to_frame([table])["trained_on"]) == [words[row.agent] for row in table.rows]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('split = "testing"', "expected one of none, training, validation, test"),
        ("seeds = [5, 0]", "first and the last of a range"),
        ("seeds = [5]", "first and the last of a range"),
        ("seeds = [0, 0x" + "f" * 9_000 + "]", "too large to show"),
        ("years = [" + "9" * 4_000 + "]", "less than or equal to 9999"),
        ("years = [99]", "greater than or equal to 1000"),
        ("years = [" + "2010, " * 201 + "]", "at most 200"),
        ('years = ["2010"]', "valid integer"),
    ],
)
def test_a_hostile_card_is_refused_in_words(tmp_path: Path, line, words):
    file = tmp_path / "card.toml"
    file.write_text(HEAD + line + "\n", encoding="utf-8")
    card, problems = check_card(file)
    assert card is None
    assert any(words in problem for problem in problems), problems
    assert all(len(problem) < 400 for problem in problems)
