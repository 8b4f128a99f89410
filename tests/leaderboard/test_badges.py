"""Badges say what the leaderboard says."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from glbench.errors import ResultError
from glbench.leaderboard import Expectation, rank
from glbench.leaderboard.tables import badge
from tests.leaderboard.synthetic import TASK, digest_of, make_result, of_another_version, stored


@pytest.fixture
def table(store):
    (found,) = rank([store("good", [3150.0, 3151.0]), store("a<b", [10.0, 11.0])], {})
    return found


def text_of(svg: str) -> str:
    return " ".join("".join(element.itertext()) for element in ET.fromstring(svg).iter() if element.tag.endswith("text"))


def test_a_badge_has_task_rank_and_reward(table):
    assert text_of(badge(table, "good")) == "glbench/Meadow-v1 rank 1 of 2, reward 3,150"


def test_only_a_reproduced_result_is_called_so_and_green(table):
    reproduced = table.model_copy(update={"rows": tuple(row.model_copy(update={"reproduced": True}) for row in table.rows)})
    assert "reproduced" in text_of(badge(reproduced, "good"))
    assert badge(reproduced, "good") != badge(table, "good").replace("3,150", "3,150, reproduced")
    assert "#2f7d4f" not in badge(table, "good")


def test_an_agent_without_a_row_is_said_with_those_there_are(table):
    with pytest.raises(ResultError, match="good"):
        badge(table, "absent")


def test_a_badge_of_a_result_without_the_metric_has_no_number(store):
    expected = {TASK: Expectation(digest_of("meadow"), (666, 667), "epi")}
    other = of_another_version(make_result("old", [10.0, 11.0]), ("epi",), {})
    (table,) = rank([store("good", [3150.0, 3151.0]), stored(other)], expected)
    assert text_of(badge(table, "old")) == "glbench/Meadow-v1 not ranked"
