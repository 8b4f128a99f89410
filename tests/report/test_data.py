"""What the page embeds is what the leaderboard says, and no text of a result can break out of it."""

from __future__ import annotations

import builtins
import gzip
import json
import re
import sys
from base64 import b64decode
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from glbench.errors import GlbenchError, TaskError
from glbench.evaluation.metrics import METRIC_NAMES
from glbench.evaluation.profiles import load_profile, profile_path
from glbench.leaderboard import Expectation, StoredResult, collect_results, rank
from glbench.leaderboard.catalogue import catalogue
from glbench.leaderboard.suites import scores_by_task, suite_table
from glbench.report import build_report, complete_profiles
from glbench.report.facts import families, optional_facts, suite_facts
from glbench.report.page import asset, script_names
from glbench.report.profile_encoding import LEVELS
from glbench.tasks import PAPER_TASK, get_task, list_tasks
from tests.leaderboard.synthetic import digest_of, make_result, result_with, stored


def blocks_of(html: str) -> dict:
    """The compressed pieces of a page by name."""
    found = re.findall(r'<script type="text/plain" id="block-([a-z0-9-]+)">([^<]*)</script>', html)
    return {name: gzip.decompress(b64decode(packed)) for name, packed in found}


def embedded(made) -> dict:
    return json.loads(blocks_of(made.report.html)["data"])


def unpacked(packed: dict) -> np.ndarray:
    """The numbers of a column of the page: sums of differences along each row, times the resolution."""
    rows = np.atleast_2d(np.array(packed["differences"], dtype=float))
    known = np.isfinite(rows)
    added = np.where(known, np.cumsum(np.where(known, rows, 0.0), axis=1), np.nan)
    return np.squeeze(added * packed["resolution"])


def test_estimates_and_ranks_are_those_of_the_leaderboard(made):
    shown = {(result["task"], result["agent"]): result for result in embedded(made)["results"]}
    rows = [row for table in made.tables for row in table.rows]
    assert len(rows) == len(shown) == 12
    for row in rows:
        result = shown[row.task_id, row.agent]
        assert (result["rank"], result["failed"], result["reproduced"]) == (row.rank, row.failed, row.reproduced)
        for name in METRIC_NAMES:
            one = row.estimates[name]
            assert result["estimates"][name] == pytest.approx([one.mean, one.low, one.high, one.iqm], rel=1e-6), name


def test_values_of_the_runs_are_those_of_the_results(made):
    shown = {result["digest"]: result for result in embedded(made)["results"]}
    for item in made.stored:
        for name in METRIC_NAMES:
            given = shown[item.result.results_digest]["values"][name]
            assert given == pytest.approx(item.result.values(name), rel=1e-6, abs=1e-12)


def test_regret_and_its_parts_are_those_of_the_leaderboard(made):
    shown = {(result["task"], result["agent"]): result["regret"] for result in embedded(made)["results"]}
    seen = 0
    for row in (row for table in made.tables for row in table.rows):
        given = shown[row.task_id, row.agent]
        assert (given is None) == row.task_id.startswith("test/")
        if given is not None:
            for part in ("total", "profit", "violations"):
                one = getattr(row.regret, part)
                assert given[part] == pytest.approx([one.mean, one.low, one.high], rel=1e-6)
            assert not given["better"]
            seen += 1
    assert seen == 6


def columns_of(document: dict) -> dict:
    """Packed columns of a profile, of its file or of the page, by part and name."""
    parts = {"day": document["day"]["columns"], "season": document["season"]["columns"]}
    parts |= {part: document[part] for part in ("worst", "hours", "calendar")}
    return {(part, name): packed for part, columns in parts.items() for name, packed in columns.items()}


def test_the_page_shows_profiles_to_half_a_step_of_what_lies_beside_the_results(made):
    shown = {result["digest"]: result for result in embedded(made)["results"]}
    blocks = blocks_of(made.report.html)
    seen = 0
    for item in made.stored:
        profile = load_profile(item.result, item.path)
        name = shown[item.result.results_digest]["profile"]
        assert (name is None) == (profile is None)
        if profile is not None:
            document = json.loads(blocks[name])
            assert document["seeds"] == profile.document["seeds"]
            genuine = columns_of(profile.document)
            for (part, column), packed in columns_of(document).items():
                kept = np.squeeze(np.atleast_2d(np.array(genuine[part, column]["values"], dtype=float)))
                kept = kept * genuine[part, column]["resolution"]
                largest = np.nanmax(np.abs(kept), initial=0.0)
                np.testing.assert_allclose(unpacked(packed), kept, rtol=0.0, atol=0.5001 * packed["resolution"])
                fine = max(genuine[part, column]["resolution"], largest / LEVELS[part])
                assert packed["resolution"] <= 1.001 * fine, (part, column)
            seen += 1
    assert seen == 6
    assert set(made.report.without_profile) == {item.path for item in made.stored if load_profile(item.result, item.path) is None}


def test_a_task_is_shown_with_its_limits_and_prices(made):
    tasks = {task["short"]: task for task in embedded(made)["tasks"]}
    cheap = tasks["CheapDays-v1"]
    assert cheap["prices"] == {"revenue": 2.4, "cost_heat": 0.05, "cost_electricity": 0.02, "cost_co2": 0.1}
    assert [(one["low"], one["high"]) for one in cheap["limits"]] == [(15.0, 34.0), (300.0, 1600.0), (50.0, 85.0)]
    assert (cheap["published"], tasks["Schiphol2010-Delta10-v1"]["published"]) == (False, True)
    assert tasks["Schiphol2010-Delta10-v1"]["versions"][0]["digest"] == tasks["Schiphol2010-Delta10-v1"]["digest"]


def test_the_figure_over_delta_has_the_tasks_of_the_suite_in_order(made):
    (family,) = embedded(made)["families"]
    assert family == {"name": "paper", "tasks": [f"glbench/Schiphol2010-Delta{delta}-v1" for delta in ("00", "10", "30")]}


def test_there_is_no_figure_over_delta_where_more_differs_than_the_crop():
    tables = [SimpleNamespace(task_id=task.id, task=task) for task in list_tasks()]
    assert [family["name"] for family in families(tables)] == ["paper", "paper-code"]


def test_the_same_results_give_the_same_page(made):
    assert build_report(made.stored).html == made.report.html


def test_text_of_a_result_cannot_end_the_script_that_holds_it(made):
    item = next(one for one in made.stored if one.result.agent.name == "doomed")
    evil = item.result.agent.model_copy(update={"information": "</script><script>alert(1)</script><!--"})
    changed = StoredResult(item.path, item.result.model_copy(update={"agent": evil}))
    page = build_report([changed]).html
    assert "<script>alert" not in page
    assert page.count("</script>") == len(re.findall(r"<script[ >]", page))


def test_what_only_some_results_say_is_shown_where_it_is_said():
    plain = {"agent": {"name": "a"}, "evaluation": {}}
    assert optional_facts(plain) == {"sandbox": None, "card": None}
    training = {"steps": 2_000_000, "wall_hours": 1.5, "hardware": None, "tasks": []}
    card = {"name": "a", "authors": ["A. Nother"], "link": None, "description": "", "training": training}
    told = optional_facts({"agent": {"name": "a", "card": card}, "evaluation": {"sandbox": "bubblewrap"}})
    assert told == {"sandbox": "bubblewrap", "card": {"authors": ["A. Nother"], "training": training}}


def test_every_metric_has_words():
    metrics = catalogue().metrics
    assert set(metrics) == set(METRIC_NAMES)
    assert all(metric.kind != "unknown" and metric.explanation for metric in metrics.values())


def test_the_page_asks_for_nothing_from_the_network(made):
    without_plotly = re.sub(r'<script type="text/plain".*?</script>', "", made.report.html, flags=re.DOTALL)
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', without_plotly)
    assert not re.findall(r"@import|url\(", without_plotly)


def test_missing_profiles_are_made_from_recorded_actions_and_results_stay_as_they_are(made, tmp_path):
    (item,) = [one for one in made.stored if (one.result.agent.name, one.result.task.id) == ("doomed", "test/Days-v1")]
    copies = {file.name: file.read_bytes() for file in item.path.parent.glob("doomed*")}
    for name, content in copies.items():
        (tmp_path / name).write_bytes(content)
    path = tmp_path / item.path.name
    profile_path(path).unlink()
    done = complete_profiles(collect_results([tmp_path]))
    assert done.profiles == (profile_path(path),)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == copies


def test_a_result_without_recorded_actions_is_named_with_the_reason(made):
    released = [item for item in made.stored if item.result.agent.name == "rule_based"]
    done = complete_profiles(released)
    assert done.profiles == ()
    assert [path for path, _ in done.impossible] == [item.path for item in released]


def test_a_result_whose_task_cannot_be_made_is_named_with_the_reason(made, monkeypatch):
    def failing(*_arguments):
        raise TaskError("There is no such model.")

    monkeypatch.setattr("glbench.report.page.load_profile", lambda *_arguments: None)
    monkeypatch.setattr("glbench.report.page.task_of_result", failing)
    done = complete_profiles(made.stored)
    assert {words for _, words in done.impossible} == {"There is no such model."}


@pytest.mark.parametrize("package", ["jinja2", "plotly"])
def test_without_the_extra_the_error_names_it(package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(GlbenchError, match=rf"{package}.*glbench\[report\]"):
        build_report(())


def test_the_library_loads_neither_jinja_nor_plotly(monkeypatch):
    imported = []
    genuine = builtins.__import__

    def watch(name: str, *rest: object, **more: object) -> object:
        imported.append(name.partition(".")[0])
        return genuine(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", watch)
    import glbench.report

    assert glbench.report.build_report is not None
    assert not {"jinja2", "plotly"} & set(imported)


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    darker, lighter = sorted((luminance(one), luminance(other)))
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("theme", [0, 1])
def test_text_has_the_contrast_that_wcag_aa_asks_for(theme):
    block = re.findall(r"\{([^{}]*--paper[^{}]*)\}", asset("style.css"))[theme]
    colours = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", block))
    for ground in ("paper", "card", "faint"):
        for ink in ("ink", "soft", "accent", "warm", "gain", "loss"):
            assert contrast(colours[ink], colours[ground]) >= 4.5, (ink, ground)


@pytest.mark.parametrize(("theme", "ground"), [("light", "#ffffff"), ("dark", "#171e1a")])
def test_lines_of_agents_have_the_contrast_that_wcag_asks_of_graphics(theme, ground):
    script = "\n".join(asset(name) for name in script_names())
    found = re.search(rf"{theme}: \[([^\]]*)\]", script)
    assert found is not None
    colours = re.findall(r"#[0-9a-f]{6}", found.group(1))
    assert len(set(colours)) == 8
    assert min(contrast(colour, ground) for colour in colours) >= 3.0


def test_a_profile_that_cannot_be_used_leaves_the_other_results_on_the_page(made, tmp_path, caplog):
    first, second = made.stored[0], made.stored[1]
    path = tmp_path / first.path.name
    path.write_bytes(first.path.read_bytes())
    profile_path(path).write_bytes(b"no gzip")
    report = build_report([StoredResult(path, first.result), second])
    assert report.results == 2
    assert path in report.without_profile
    assert "Cannot read the profile" in caplog.text


def test_a_result_that_shares_its_digest_under_another_task_does_not_speak_for_the_released_one(made):
    original = next(item for item in made.stored if item.result.task.id == PAPER_TASK)
    task = original.result.task.model_copy(update={"id": "zzz/Schiphol2010-Delta10-v1"})
    agent = original.result.agent.model_copy(update={"information": "something else"})
    foreign = replace(original, result=original.result.model_copy(update={"task": task, "agent": agent}))
    data = build_report([*made.stored, foreign]).data
    sees = {(one["task"], one["agent"]): one["sees"] for one in data["results"]}
    name = original.result.agent.name
    assert sees[original.result.task.id, name] == original.result.agent.information
    assert sees[task.id, name] == "something else"
    short = {task["id"]: task["short"] for task in data["tasks"]}
    assert short[original.result.task.id] == "Schiphol2010-Delta10-v1"
    assert short[task.id] == task.id


def test_two_tasks_of_users_with_one_name_are_called_by_their_whole_ids():
    results = [make_result(name, [1.0, 2.0], task_id=f"{name}/Own-v1") for name in ("alice", "bob")]
    tasks = build_report([stored(one) for one in results]).data["tasks"]
    assert [task["short"] for task in tasks] == [task["id"] for task in tasks] == ["alice/Own-v1", "bob/Own-v1"]


@pytest.mark.parametrize("task", ["Spring-v1", "FullSeason-v1", "Lettuce-v1", "Schiphol2010-Delta10-v1"])
def test_what_is_sold_and_bought_has_colours_of_its_own(task):
    colours = [item.colour for item in catalogue(get_task(task)).items]
    assert len(set(colours)) == len(colours)


def test_a_suite_in_money_has_its_ranks_places_at_prices_and_no_normalised_scores():
    task = "glbench/Meadow-v1"
    made_up = [stored(result_with(name, [p, p + 0.1], [v, v])) for name, p, v in (("careful", 5.0, 1.0), ("bold", 6.0, 2.5))]
    expected = {task: Expectation(digest_of("meadow"), (666, 667))}
    tables, scores, penalties = rank(made_up, expected), scores_by_task(made_up, expected), scores_by_task(made_up, expected, "penalty")
    facts = suite_facts(suite_table("meadows", (task,), scores, {}, tables, penalties=penalties))
    assert facts["in_money"]
    assert "no plans are known" in facts["scale"]
    assert (facts["thresholds"], facts["profiles"]) == ([], {})
    assert facts["turns"] == [["careful", "bold", pytest.approx(2 / 3)]]
    first = facts["rows"][0]
    assert (first["agent"], first["rank"], first["iqm"], first["regret"]) == ("careful", 1, None, None)
    assert first["mean"][0] == pytest.approx(4.05)
    assert first["at_prices"] == [[0.5, 2, pytest.approx(4.55)], [1.0, 1, pytest.approx(4.05)], [2.0, 1, pytest.approx(3.05)]]
