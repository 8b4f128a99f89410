"""What an agent does differently and what that earns: periods that add up, words that follow from the numbers, a page without a script."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.errors import GlbenchError, ResultError
from glbench.evaluation import evaluate, load_result
from glbench.report.story import (
    BRIGHT_DAYS,
    DULL_DAYS,
    document_of,
    headline,
    ledger_table,
    page_of,
    paragraphs,
    parts_of,
    periods_of,
    tell,
    text_of,
    week_table,
)
from tests.report.conftest import OTHER_PRICES, small_task, write_agent


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Three agents on the small task, one of which fails in all runs, and one on the same days at other prices."""
    folder = tmp_path_factory.mktemp("story")
    days, cheap = small_task(folder, "Days"), small_task(folder, "CheapDays", OTHER_PRICES)
    for task, name in ((days, "thrifty"), (days, "lavish"), (days, "doomed"), (cheap, "lavish")):
        evaluate(task, write_agent(folder, name), out=folder)
    return folder / "results"


@pytest.fixture(scope="module")
def paths(results):
    return results / "Days-v1" / "thrifty.json", results / "Days-v1" / "lavish.json"


@pytest.fixture(scope="module")
def told(paths):
    return tell(*paths)


def test_a_day_has_its_night_its_dawn_and_its_day():
    """Light from 7:00 to 17:00: dawn from 6:00 to 9:00."""
    sun = np.zeros(24)
    sun[7:17] = 300.0
    parts = "".join("nad"[part] for part in parts_of(sun, np.zeros(24, dtype=int), 3600.0))
    assert parts == "nnnnnnaaaddddddddnnnnnnn"


def test_a_day_without_light_is_a_night():
    assert not parts_of(np.full(24, 4.0), np.zeros(24, dtype=int), 3600.0).any()


def test_half_of_the_days_are_bright():
    periods = periods_of(np.array([[1.0, 5.0], [3.0, 9.0]]))
    assert periods[..., 2].tolist() == [[DULL_DAYS, BRIGHT_DAYS], [DULL_DAYS, BRIGHT_DAYS]]
    assert (periods[..., 0] == 0).all()


@pytest.mark.parametrize("metric", ["epi", "reward", "penalty", "cost_heat", "heat"])
def test_the_periods_add_up_to_the_difference_of_the_results(told, paths, metric):
    one, other = (load_result(path).values(metric) for path in paths)
    place = [line.name for line in told.lines].index(metric)
    assert told.gaps()[:, place].sum() == pytest.approx(np.mean(one) - np.mean(other), rel=1e-9, abs=1e-12)
    assert told.weeks[0, :, place].sum() - told.weeks[1, :, place].sum() == pytest.approx(told.gaps()[:, place].sum())


def test_periods_last_as_long_as_the_run_and_their_means_make_that_of_the_run(told):
    hours = told.task.steps * told.task.step_seconds / 3600.0
    assert told.times.sum() == pytest.approx(hours)
    known = told.times > 0
    by_period = (told.means[:, known] * told.times[known][:, None]).sum(axis=1) / hours
    assert by_period == pytest.approx(np.nanmean(told.hours, axis=1), rel=1e-6)


def test_told_the_other_way_round_everything_is_the_opposite(told, paths):
    assert tell(paths[1], paths[0]).gaps() == pytest.approx(-told.gaps())


def test_the_words_say_the_numbers(told):
    profit = told.line("profit")
    gap = told.gaps()[:, profit].sum()
    first = headline(told)
    assert f"thrifty earns {abs(gap):.2f} EUR/m² {'more' if gap > 0 else 'less'} than lavish".replace(" EUR", "\u00a0EUR") in first
    assert "At night" in paragraphs(told)[0]
    night = told.means[:, 0, [curve.path for curve in told.levels].index("climate/air_temperature")]
    assert f"air temperature {night[0]:.1f} instead of {night[1]:.1f}\u00a0°C" in paragraphs(told)[0]
    rows = {row[0]: row[1:] for row in ledger_table(told).rows}
    assert float(rows["Profit"][-1].replace("−", "-")) == pytest.approx(gap, abs=0.005)


def test_what_hardly_differs_is_not_told(told):
    alike = replace(told, means=told.means[[0, 0]], sums=told.sums[[0, 0]])
    assert all("climate and controls hardly differ" in words for words in paragraphs(alike))
    assert "The profits of thrifty and lavish cannot be told apart, 0.00\u00a0EUR/m²" in headline(alike)


def test_a_difference_that_may_be_chance_is_not_called_more(told):
    sums, profit = told.sums.copy(), told.line("profit")
    sums[0] = sums[1]
    sums[0, :, 0, profit] += np.array([3.0, -2.5, 0.1])
    words = headline(replace(told, sums=sums))
    assert "The profits of thrifty and lavish cannot be told apart, +0.20\u00a0EUR/m²" in words
    assert "earns" not in words
    one = headline(replace(told, sums=sums[:, :1], seeds=told.seeds[:1]))
    assert "earns 3.00\u00a0EUR/m² more" in one
    assert "one run: it says nothing about others" in one


def test_the_page_shows_charts_with_axis_titles_and_needs_no_script(told):
    page = page_of(told)
    assert "<script" not in page
    assert page.count('class="line one"') == page.count("hour of the local day") + 1  # and one in the legend
    assert page.count("hour of the local day") >= 6
    assert ">°C</text>" in page
    assert "31.65 MJ/m³" in page
    assert len(page) < 100_000
    hostile = replace(told, agents=("<b>x</b>", "y"))
    assert "<b>x</b>" not in page_of(hostile)


def test_weeks_of_both_are_tables_with_the_same_columns(told):
    one, other = (week_table(told, side) for side in (0, 1))
    assert one.heads == other.heads
    assert any(head == "Heat as natural gas, m³/m²" for head in one.heads)
    assert one.rows != other.rows


def test_the_document_is_json_with_the_words_in_it(told):
    document = json.loads(json.dumps(document_of(told), allow_nan=False))
    assert document["words"] == text_of(told)
    assert len(document["by_hour"]) == 2


def test_results_that_cannot_be_told_against_each_other_are_refused(results, paths):
    with pytest.raises(ResultError, match="Both results are of thrifty"):
        tell(paths[0], paths[0])
    with pytest.raises(ResultError, match="only results of one task"):
        tell(paths[0], results / "CheapDays-v1" / "lavish.json")
    with pytest.raises(ResultError, match=r"3 of 3 runs of doomed failed .*no run in common") as failed:
        tell(paths[0], results / "Days-v1" / "doomed.json")
    assert "doomed.json" in str(failed.value)
    assert "Evaluate" not in str(failed.value), "other seeds would not help"


def test_failed_runs_are_told_first(told):
    broken = replace(told, failed=("1 of 3 runs of lavish failed (crashed: 1)",))
    assert text_of(broken)[0].startswith("1 of 3 runs of lavish failed (crashed: 1). What follows is about the 3 runs")
    assert "runs of lavish failed" in page_of(broken)
    assert text_of(told)[0] == headline(told)


def test_what_rounds_to_nothing_has_no_column_among_the_weeks(told):
    noise = replace(told, weeks=np.where(told.weeks > 0, 1e-6, 0.0))
    assert week_table(noise, 0).heads == ("Week",)


def test_the_command_tells_the_story_and_writes_the_page(paths, tmp_path):
    page = tmp_path / "story.html"
    done = CliRunner().invoke(app, ["story", str(paths[0]), "--against", "lavish", "--page", str(page), "-w", "1"])
    assert done.exit_code == 0, done.output
    assert "thrifty earns" in done.output
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--page", "RESULT"], "should end with .html"),
        (["--page", "story.txt"], "should end with .html"),
        (["--task", "Spring-v1"], "is a result on test/Days-v1, but --task says Spring-v1"),
    ],
)
def test_the_command_refuses_before_it_simulates_and_leaves_results_alone(paths, options, words, monkeypatch):
    monkeypatch.setattr("glbench.report.story.tell", lambda *_: pytest.fail("simulated"))
    before = paths[0].read_bytes()
    options = [str(paths[0]) if option == "RESULT" else option for option in options]
    done = CliRunner().invoke(app, ["story", str(paths[0]), "--against", "lavish", *options])
    assert isinstance(done.exception, GlbenchError)
    assert words in str(done.exception)
    assert paths[0].read_bytes() == before


def test_a_missing_opponent_is_named_with_the_command_that_makes_it(paths):
    done = CliRunner().invoke(app, ["story", str(paths[0])])
    assert isinstance(done.exception, ResultError)
    assert "glbench evaluate rule_based_tuned --task FILE.toml --seed" in str(done.exception), (
        "not a shipped task, so the command asks for its file"
    )
    assert f"--out {paths[0].parent.parent.parent}" in str(done.exception)
