"""What footnotes say of intervals and of equal rewards follows from the tasks of the tables."""

from __future__ import annotations

import pytest

from glbench.leaderboard import TaskTable
from glbench.leaderboard.catalogue import catalogue
from glbench.leaderboard.tables import footnotes, score_note
from glbench.tasks import get_task

PAPER, SPRING = "glbench/Schiphol2010-Delta10-v1", "glbench/Spring-v1"


def board(task_id: str) -> TaskTable:
    """An empty table of a published task."""
    task = get_task(task_id)
    return TaskTable(task_id=task_id, title=task.title, digest=task.digest, metric=task.evaluation.metric, rows=(), task=task)


@pytest.mark.parametrize(
    ("tasks", "covers"),
    [
        ((), "the draws of one season, and one training; another season or another training"),
        ((PAPER,), "the draws of one season, and one training; another season or another training"),
        ((SPRING,), "the draws of seasons of the same years, and one training; another year or another training"),
        (
            (PAPER, SPRING),
            "the draws of one season, or of seasons of the same years where a task has several, and one training; "
            "another season or year or another training",
        ),
    ],
)
def test_an_interval_covers_the_seasons_of_its_task(tasks, covers):
    (note,) = [note for note in footnotes([board(task_id) for task_id in tasks]) if "95 % interval covers" in note]
    assert f"A 95 % interval covers {covers} can lie far outside." in note


def test_rewards_count_as_the_same_where_they_are_scaled_as_the_papers():
    def told(*tasks: str) -> int:
        return sum("less than 8 counts as the same" in note for note in footnotes([board(task) for task in tasks]))

    assert (told(PAPER), told(SPRING), told(PAPER, SPRING), told()) == (1, 0, 1, 1)


def test_the_notes_of_suites_follow_their_tasks():
    assert "another season or another training can move" in score_note([PAPER])
    assert "the draws of seasons of the same years, and one training" in score_note([SPRING])
    assert "another year or another training can move" in score_note([SPRING])


@pytest.mark.parametrize(
    ("task_id", "start"),
    [
        (PAPER, "Controllers run the same greenhouse through the same season: they heat"),
        (SPRING, "Controllers run a greenhouse through the same seasons: they earn"),
        ("glbench/Lettuce-v1", "Controllers run a greenhouse through the same seasons: they earn with heads"),
    ],
)
def test_the_page_says_whether_runs_share_a_season(task_id, start):
    assert catalogue(get_task(task_id)).lead.startswith(start)
