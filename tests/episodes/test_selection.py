"""Which runs become full episodes."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.episodes import chosen_rows, parse_selection
from glbench.errors import EpisodeError
from glbench.evaluation import evaluate
from tests.episodes.day import RANDOM

SEEDS, VALUES = (10, 11, 12, 13), (2.0, -1.0, 5.0, 3.0)


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("all", (0, 1, 2, 3)),
        ("none", ()),
        ("best", (2,)),
        ("worst", (1,)),
        ("median", (0,)),
        ("best,worst,median", (0, 1, 2)),
        ("13, best", (2, 3)),
    ],
)
def test_words_and_seeds_choose_runs(text, rows):
    assert chosen_rows(parse_selection(text), SEEDS, VALUES) == rows


def test_of_equal_runs_the_smaller_seed_is_the_best():
    assert chosen_rows(("best",), (5, 6), (1.0, 1.0)) == (0,)


@pytest.mark.parametrize(("text", "words"), [("bset", "best"), ("all,best", "alone"), ("", "chooses no episode")])
def test_other_words_are_refused(text, words):
    with pytest.raises(EpisodeError, match=words):
        parse_selection(text)


def test_a_seed_that_no_run_has_is_told_before_anything_is_simulated(day_task, write_agent, tmp_path):
    with pytest.raises(EpisodeError, match="No run has the seed 3"):
        evaluate(day_task, write_agent(RANDOM), out=tmp_path, episodes="best,3")


def test_a_new_result_leaves_no_episodes_of_the_old_one(day_task, write_agent, tmp_path):
    agent = write_agent(RANDOM)
    evaluate(day_task, agent, out=tmp_path, episodes="all")
    assert len(list((tmp_path / "episodes").rglob("*.mcap"))) == 3
    evaluate(day_task, agent, out=tmp_path, episodes="none", fresh=True)
    assert list((tmp_path / "episodes").rglob("*.mcap")) == []
    evaluate(day_task, agent, out=tmp_path, episodes="best,worst")  # the stored result, and the episodes that it lacks
    assert len(list((tmp_path / "episodes").rglob("*.mcap"))) == 2


def test_without_a_folder_nothing_is_recorded(day_task, write_agent):
    assert evaluate(day_task, write_agent(RANDOM), episodes="all").record is None


@pytest.mark.parametrize("damage", [Path.unlink, lambda record: record.write_bytes(record.read_bytes()[:300])], ids=["gone", "cut off"])
def test_a_stored_result_without_its_record_is_evaluated_again(day_task, write_agent, tmp_path, caplog, damage):
    agent = write_agent(RANDOM)
    evaluate(day_task, agent, out=tmp_path)
    (record,) = (tmp_path / "results").rglob("*.actions.mcap")
    content = record.read_bytes()
    damage(record)
    evaluate(day_task, agent, out=tmp_path)
    assert record.read_bytes() == content
    assert "are missing or damaged" in caplog.text
