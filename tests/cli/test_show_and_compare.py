"""``glbench show`` and ``glbench compare`` on released results: numbers with units, and sentences."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from glbench.cli.results import sparkline
from glbench.evaluation import load_result
from glbench.evaluation.files import save_result
from glbench.resources import data_folder
from glbench.tasks.references import read_best_known
from tests.leaderboard.synthetic import make_result

pytestmark = pytest.mark.usefixtures("few_released")
TASK = "Schiphol2010-Delta10-v1"
RELEASED = data_folder("reports/released/results")


def test_show_tells_every_metric_and_where_the_money_went(glbench):
    done = glbench("show", "rule_based")
    assert done.code == 0
    for words in ("EPI = revenue - costs", "EUR/m²", "kWh/m²", "Where the money went", "lamps", "Worst run: seed"):
        assert words in done.out


def test_show_of_an_unknown_agent_names_the_nearest(glbench):
    done = glbench("show", "rule_baced")
    assert done.code == 1
    assert "rule_based" in done.err


def test_compare_says_who_earns_more_and_from_what(glbench):
    done = glbench("compare", "rule_based", "rule_based_fair", "--task", TASK)
    assert done.code == 0
    assert "rule_based earns" in done.out
    assert done.out.index("has the higher reward, by") < done.out.index("rule_based earns")
    assert "EUR/m² more than rule_based_fair" in done.out


def test_compare_keeps_every_digit_at_80_columns(glbench, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    told = glbench("compare", "rule_based", "rule_based_fair", "--task", TASK).out
    assert "A - B" in told
    assert "…" not in told


def test_compare_judges_few_runs_too_and_leaves_out_what_neither_has(here, glbench):
    for name, level in (("lazy", 0.0), ("busy", 0.01)):
        text = (here / "steady.py").read_text(encoding="utf-8").replace("0.01", str(level))
        (here / f"{name}.py").write_text(text, encoding="utf-8")
        assert glbench("evaluate", f"{name}.py", "--task", "day.toml").code == 0
    done = glbench("compare", "lazy", "busy", "--task", "day.toml")
    assert done.code == 0
    told = " ".join(done.out.split())
    assert "3 pairs of runs" in told
    assert "too few for the test" not in told
    assert "0.000 to 0.000" not in told
    lines = done.out.splitlines()
    assert not [line for line in lines if "-0.000" in line]
    assert not [line for line in lines if "air too hot" in line], "neither was ever too hot"


def test_compare_says_first_that_runs_failed(here, glbench):
    broken = (here / "steady.py").read_text(encoding="utf-8").replace("0.01", "np.nan")
    (here / "broken.py").write_text(broken, encoding="utf-8")
    for name in ("steady", "broken"):
        glbench("evaluate", f"{name}.py", "--task", "day.toml")
    done = glbench("compare", "steady", "broken", "--task", "day.toml")
    assert done.out.startswith("3 of 3 runs of broken failed (invalid action: 3)")


def test_show_tells_regret_with_its_parts_and_whose_the_best_known_runs_are(glbench):
    known = read_best_known(f"glbench/{TASK}")
    result = load_result(RELEASED / TASK / "rule_based.json")
    shown = glbench("show", "rule_based", "--task", TASK).out
    mean = np.mean([run.reward for run in known.runs]) - result.summary.mean["reward"]
    (line,) = [line for line in shown.splitlines() if "Regret to best known" in line]
    assert f"{mean:,.2f}" in line
    assert "profit given away" in shown
    assert "violations added" in shown
    assert "Best known runs of the task: by " in shown
    assert "glbench bound" not in shown, "released results are what the best known runs are taken from"


def test_compare_has_the_regrets_of_both_and_json_their_difference(glbench):
    assert "Regret to best known" in glbench("compare", "rule_based", "rule_based_fair", "--task", TASK).out
    (pair,) = json.loads(glbench("compare", "rule_based", "rule_based_fair", "--task", TASK, "--json").out)
    assert pair["regret"].keys() == {"total", "profit", "violations"}
    assert pair["regret"]["total"]["difference"] == pytest.approx(-pair["metrics"]["reward"]["difference"])


def test_where_only_the_first_runs_have_plans_show_and_compare_say_over_which_runs_regrets_are(glbench):
    rules, nothing = (RELEASED / "FullSeason-v1" / f"{agent}.json" for agent in ("rule_based_energy", "do_nothing"))
    planned = len(read_best_known("glbench/FullSeason-v1").runs)
    assert planned < len(load_result(rules).runs)
    shown = " ".join(glbench("show", rules).out.split())
    assert f"Regrets are means over runs with a best known plan: {planned} of {len(load_result(rules).runs)}." in shown
    assert f"Regrets are means over the first {planned} runs of the task; no plans are known for the others." in shown
    compared = " ".join(glbench("compare", rules, nothing).out.split())
    assert f"Regrets are means over the {planned} of these pairs that have a best known run." in compared
    (pair,) = json.loads(glbench("compare", rules, nothing, "--json").out)
    assert pair["regret_runs"] == planned


def test_show_names_the_source_the_other_trainings_and_what_is_only_stated(glbench):
    shown = glbench("show", "ppo", "--task", TASK).out
    assert "Source: released; reproduced by glbench verify" in shown
    assert "One of ppo (3 trainings): reward" in shown
    assert "The others: ppo_seed1, ppo_seed2." in shown
    assert "Stated by the file, not checked: decision" in shown


def test_a_line_break_in_a_card_makes_no_line(glbench, tmp_path):
    authors = ("Anna\nSource: released; reproduced by glbench verify\n",)
    path = save_result(make_result("anna", [1.0, 2.0], recipe=("of_anna", 0), authors=authors), tmp_path)
    shown = glbench("show", path).out
    assert "card by Anna Source: released" in " ".join(shown.split())
    assert not [line for line in shown.splitlines() if line.startswith("Source: released")]


def test_compare_takes_all_trainings_of_an_agent_and_one_by_its_name(glbench):
    (pair,) = json.loads(glbench("compare", "ppo", "rule_based", "--task", TASK, "--json").out)
    (one,) = json.loads(glbench("compare", "ppo_seed1", "rule_based", "--task", TASK, "--json").out)
    assert (pair["trainings"], one["trainings"]) == ([3, 1], [1, 1])
    means = [load_result(RELEASED / TASK / f"{name}.json").summary.mean["reward"] for name in ("ppo", "ppo_seed1", "ppo_seed2")]
    assert pair["metrics"]["reward"]["first"] == pytest.approx(sum(means) / 3)
    assert one["metrics"]["reward"]["first"] == pytest.approx(means[1])
    told = glbench("compare", "ppo", "rule_based", "--task", TASK)
    assert "ppo is the mean of 3 trainings" in " ".join(told.err.split())


def test_compare_gives_the_same_numbers_as_json(glbench):
    done = glbench("compare", "rule_based", "rule_based_fair", "--task", TASK, "--json")
    (pair,) = json.loads(done.out)
    metric = pair["metrics"]["epi"]
    assert metric["difference"] == pytest.approx(metric["first"] - metric["second"])
    assert sum(pair["money [EUR m-2]"].values()) == pytest.approx(metric["difference"])


def test_an_agent_is_not_compared_with_itself(glbench):
    done = glbench("compare", "rule_based", "rule_based", "--task", TASK)
    assert done.code == 1
    assert "one and the same result" in done.err


def test_a_folder_that_is_not_there_is_no_empty_one(glbench, tmp_path):
    for command in (("show", "rule_based"), ("compare", "rule_based", "rule_based_fair"), ("badge", "rule_based")):
        done = glbench(*command, "--out", tmp_path / "reprots")
        assert done.code == 1
        assert "There is no folder" in done.err


@pytest.mark.usefixtures("all_released")
def test_agents_are_compared_over_all_tasks_that_both_have(glbench):
    done = glbench("compare", "rule_based", "rule_based_fair")
    assert done.code == 0
    assert "task by task" in done.out
    assert "higher score on 16 of 18 tasks, rule_based_fair on 0; on 2 they cannot be told apart." in done.out
    assert "the difference is the same in every run" in done.out


def test_a_sparkline_rises_with_its_values():
    assert sparkline([0.0, 1.0, 2.0, 7.0]) == "▁▂▃█"
    assert sparkline([3.0, 3.0]) == "▁▁"


@pytest.mark.parametrize("place", [("agent", "information"), ("evaluation", "sandbox"), ("created",)], ids=str)
def test_a_changed_copy_of_a_released_result_is_not_called_released(glbench, tmp_path, place):
    """The digest of its runs is the same: it does not cover what the file states of the agent and its evaluation."""
    document = json.loads((RELEASED / TASK / "rule_based_fair.json").read_text(encoding="utf-8"))
    inner = document
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = "bubblewrap"
    (tmp_path / "x.json").write_text(json.dumps(document), encoding="utf-8")
    shown = glbench("show", str(tmp_path / "x.json"))
    assert shown.code == 0
    assert "Source:" not in shown.out


def test_a_task_without_a_result_is_named_also_beside_others(glbench):
    both = ("--task", TASK, "--task", "Sprng-v1")
    for command in (("show", "rule_based"), ("compare", "rule_based", "rule_based_fair")):
        answer = glbench(*command, *both)
        assert answer.code == 1
        assert "Sprng-v1" in answer.err
        assert TASK not in answer.err.partition("It has")[0]


def test_a_short_task_name_is_the_published_one(glbench, tmp_path):
    document = json.loads((RELEASED / TASK / "rule_based_fair.json").read_text(encoding="utf-8"))
    document["task"].update(id=f"zzz/{TASK}")
    folder = tmp_path / "results" / "x"
    folder.mkdir(parents=True)
    (folder / "rule_based_fair.json").write_text(json.dumps(document), encoding="utf-8")
    shown = glbench("leaderboard", "--task", TASK, "--out", str(tmp_path), "--json")
    assert {row["task"] for row in json.loads(shown.out)} == {f"glbench/{TASK}"}


def test_story_and_view_take_an_agent_by_its_name(here, glbench):
    (here / "rival.v2.py").write_text((here / "steady.py").read_text(encoding="utf-8"), encoding="utf-8")
    assert glbench("evaluate", "steady.py", "rival.v2.py", "--task", "day.toml").code == 0
    done = glbench("story", "steady", "--task", "day.toml", "--against", "rival.v2")
    assert done.code == 0, done.err
    assert "rival.v2" in done.out
    assert glbench("view", "steady", "rival.v2", "--task", "day.toml", "--save", "runs.rrd").code == 0
    assert (here / "runs.rrd").is_file()
    unknown = glbench("view", "stedy", "--task", "day.toml", "--save", "none.rrd")
    assert unknown.code == 1
    assert "Did you mean 'steady'" in unknown.err
    result = next((here / "reports" / "results").glob("*/steady.json"))
    for command in (("view", result, "--save", "none.rrd"), ("show", result), ("compare", result, result.with_name("rival.v2.json"))):
        other = glbench(*map(str, command), "--task", TASK)
        assert other.code == 1
        assert re.search(rf"but --task says \S*{TASK}\. Leave out --task\.", other.err.replace("\n", " "))
    assert not (here / "none.rrd").exists()


@pytest.mark.parametrize(
    ("base", "agent", "rules"),
    [("WinterLED-v1", "steady.py", "rule_based_energy"), ("LettuceHarvest-v1", "rule_based_harvest_46", "rule_based_harvest")],
)
def test_a_story_is_told_against_the_rules_of_such_tasks(here, glbench, base, agent, rules):
    """Those for power at hourly prices also without engine and buffer, as in WinterLED-v1."""
    head = f'base = "glbench/{base}"\nid = "mine/Other-v1"\ntitle = "A day"\nsuites = ["mine"]\n'
    (here / "other.toml").write_text(f"{head}[weather]\ndays = 1\n[evaluation]\nruns = 1\n", encoding="utf-8")
    assert glbench("evaluate", agent, "--task", "other.toml").code == 0
    alone = glbench("story", Path(agent).stem, "--task", "other.toml")
    assert alone.code == 1
    assert f"{rules}.json" in alone.err.replace("\n", "")
