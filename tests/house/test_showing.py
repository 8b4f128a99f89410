"""What notebooks show of tasks, results, episodes and tables: the numbers that are in them, and no markup of others."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import pytest

from glbench.evaluation import load_result
from glbench.leaderboard import collect_results, rank
from glbench.resources import data_folder
from glbench.tasks import get_task, list_tasks
from glbench.untrusted import html_of, visible


class Balanced(HTMLParser):
    """Raises when a tag is closed that was not open."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def words(html: str) -> str:
    Balanced(html)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", html))


def test_texts_are_escaped_and_numbers_stand_right() -> None:
    html = html_of("a <b>", [("name", "<script>")], ("x", "y"), [(1.23456789, "text"), (2, "\x1b[31m")])
    assert "<script" not in html
    assert "<b>" not in html
    assert "\x1b" not in html
    assert '<td style="text-align:right">1.235</td><td style="text-align:left">text</td>' in html
    Balanced(html)


@pytest.mark.parametrize("task", [task.id for task in list_tasks()])
def test_a_task_shows_its_limits(task: str) -> None:
    spec = get_task(task)
    shown = words(spec._repr_html_())
    assert spec.id in shown
    assert f"{spec.step_seconds / 60:g} min" in shown
    for name, limits in spec.constraints.items():
        assert re.search(rf"{name} \S+ +{limits.low:.4g} +{limits.high:.4g} ", re.sub(r" +", " ", shown))


def test_a_result_and_a_leaderboard_show_their_means() -> None:
    folder = data_folder("reports") / "released" / "results" / "Spring-v1"
    result = load_result(folder / "rule_based.json")
    shown = words(result._repr_html_())
    assert f"reward {result.units['reward']} {result.summary.mean['reward']:.4g}" in re.sub(r" +", " ", shown)
    assert "100 ok" in shown
    (table,) = rank(collect_results([folder]), {})
    row = table.rows[0]
    assert re.search(rf"1 {row.agent} {row.estimates['reward'].mean:.4g} ", re.sub(r" +", " ", words(table._repr_html_())))


def test_a_no_break_space_before_a_unit_is_shown_and_marks_that_turn_text_are_not() -> None:
    assert visible("1.49\u00a0EUR/m²") == "1.49\u00a0EUR/m²"
    assert visible("a\u202eb\x1b") == "a?b?"
