"""Regret to the best known runs: hand values, parts that add up, what counts as best known, and runs that have none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import TaskError
from glbench.leaderboard import Expectation, collect_results, rank, to_frame, to_markdown
from glbench.leaderboard.collect import published_expectations
from glbench.leaderboard.entries import entry_of
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.regret import best_known_from, can_be_best_known, regret_of
from glbench.leaderboard.statistics import estimate_mean
from glbench.leaderboard.suites import references_from, suite_table
from glbench.leaderboard.tables import regret_notes, suite_frame, suite_markdown, to_json, to_latex
from glbench.resources import data_folder
from glbench.tasks import references as references_module
from glbench.tasks.references import BestKnown, KnownRun, References, read_best_known, read_references, write_best_known
from tests.leaderboard.synthetic import MONEY, TASK, digest_of, make_result, result_with, stored

SEEDS = (666, 667, 668, 669)
EXPECTED = {TASK: Expectation(digest_of("meadow"), SEEDS)}
EPI, PENALTY = (4.0, 5.0, 6.0, 8.0), (0.5, 0.0, 1.0, 0.0)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for best known runs, without any."""
    folder = tmp_path / "known"
    monkeypatch.setattr(references_module, "best_known_path", lambda task_id: folder / f"{task_id.rpartition('/')[2]}.json")
    return folder


@pytest.fixture
def known(home: Path) -> BestKnown:
    """Best known runs of a task whose reward is profit minus penalty [EUR m-2]: 3.5, 5, 5 and 8."""
    runs = tuple(
        KnownRun(seed=seed, reward=epi - penalty, epi=epi, penalty=penalty, agent="champion")
        for seed, epi, penalty in zip(SEEDS, EPI, PENALTY, strict=True)
    )
    return stored_known(runs)


def stored_known(runs: tuple[KnownRun, ...], units: dict[str, str] | None = None) -> BestKnown:
    found = BestKnown(task=TASK, task_digest=digest_of("meadow"), units=units or MONEY, agents={"champion": digest_of("c")}, runs=runs)
    write_best_known(found)
    return found


def test_regret_is_the_best_known_minus_the_score_seed_by_seed_and_its_parts_add_up(known):
    result = result_with("anna", [3.0, 5.0, 5.0, 6.0], [1.0, 0.5, 0.0, 2.0])
    # Rewards 2, 4.5, 5 and 4: regrets 1.5, 0.5, 0 and 4. Profit 1, 0, 1 and 2; violations 0.5, 0.5, -1 and 2.
    regret = regret_of([result])
    assert regret.unit == "EUR m-2"
    assert regret.total.mean == 1.5
    assert regret.profit.mean == 1.0
    assert regret.violations.mean == 0.5
    assert regret.profit.mean + regret.violations.mean == regret.total.mean
    interval = estimate_mean([np.array([1.5, 0.5, 0.0, 4.0])]).interval()
    assert (regret.total.low, regret.total.high) == (interval.low, interval.high)
    assert regret.runs_ahead == 0


def test_runs_are_paired_by_their_seeds_and_not_by_their_places(known):
    # Only the seeds 668 and 669, whose best known runs are the third and the fourth.
    result = result_with("trial", [6.0, 8.0], [2.0, 1.0], first_seed=668)
    assert regret_of([result]).total.mean == (1.0 + 1.0) / 2


@pytest.mark.parametrize(
    "changes",
    [
        {"first_seed": 700},
        {"task_id": "glbench/Elsewhere-v1"},
        {"task_id": "mylab/Meadow-v1"},
        {"task_digest": digest_of("another meadow")},
        {"split": "validation"},
        {"salt_commitment": digest_of("salt")},
    ],
)
def test_other_seeds_tasks_versions_splits_and_salts_have_no_regret(known, changes):
    result = result_with("anna", list(EPI), list(PENALTY), **changes)
    assert regret_of([result]) is None
    (table,) = rank([stored(result)], {})
    assert table.rows[0].regret is None
    assert "Regret" not in to_markdown([table], {})
    assert "Regret" not in to_latex(table)
    assert to_frame([table]).filter(regex="^regret_").isna().all(axis=None)
    assert json.loads(to_json([table]))["tasks"][0]["rows"][0]["regret"] is None
    assert compare_entries(entry_of(stored(result)), entry_of(stored(result))).regret == {}


def test_a_result_that_states_no_penalty_has_a_regret_without_its_parts(known):
    result = result_with("old", list(EPI), list(PENALTY))
    runs = tuple(run.model_copy(update={"metrics": {k: v for k, v in run.metrics.items() if k != "penalty"}}) for run in result.runs)
    regret = regret_of([result.model_copy(update={"runs": runs})])
    assert (regret.total.mean, regret.profit.mean, regret.violations) == (0.0, 0.0, None)


def test_where_the_reward_has_no_unit_the_parts_keep_their_own(home):
    """As on the paper's tasks: 50 points of reward for one EUR/m2, minus the penalty."""
    units = MONEY | {"reward": "-", "penalty": "-"}
    stored_known(tuple(KnownRun(seed=seed, reward=390.0, epi=8.0, penalty=10.0, agent="champion") for seed in SEEDS), units)
    regret = regret_of([result_with("anna", [7.0] * 4, [30.0] * 4, [320.0] * 4)])
    assert (regret.unit, regret.total.mean, regret.profit.mean, regret.violations.mean) == ("-", 70.0, 1.0, 20.0)


def test_who_is_above_the_best_known_in_some_runs_has_a_negative_regret_there_and_is_told_how_to_hand_it_in(known):
    result = result_with("anna", [5.0, 5.0, 6.0, 9.0], [0.5, 0.0, 1.0, 0.0])  # better by 1 in the first and the last
    (table,) = rank([stored(result)], EXPECTED)
    row = table.rows[0]
    assert (row.regret.total.mean, row.regret.profit.mean, row.regret.violations.mean) == (-0.5, -0.5, 0.0)
    assert row.regret.runs_ahead == 2
    (note,) = regret_notes(table)
    assert note.startswith("anna is above the best known run in 2 of the 4 runs that have one: a better plan than the best known.")
    assert note.endswith("glbench bound --submit anna.json")
    assert "glbench bound --submit anna.json" in to_markdown([table], {})


def test_who_sets_controls_past_the_actuation_is_not_asked_for_a_plan(known):
    result = result_with("anna", [9.0] * 4, [0.0] * 4, privileged=True)
    (table,) = rank([stored(result)], EXPECTED)
    assert table.rows[0].regret.runs_ahead == 4
    assert regret_notes(table) == []


def test_equal_runs_are_not_ahead_by_rounding(known):
    result = result_with("anna", [value + 1e-9 for value in EPI], list(PENALTY))
    assert regret_of([result]).runs_ahead == 0


def test_trainings_have_the_interval_of_other_estimates(known):
    first = result_with("a", [3.0, 5.0, 5.0, 6.0], [0.0] * 4, recipe=("a", 0))
    second = result_with("a_seed1", [2.0, 4.0, 4.0, 5.0], [0.0] * 4, recipe=("a", 1))
    # Rewards are the profits: regrets 0.5, 0, 0, 2, and 1.5, 1, 1, 3.
    gaps = np.array([[0.5, 0.0, 0.0, 2.0], [1.5, 1.0, 1.0, 3.0]])
    ((row,),) = [table.rows for table in rank([stored(first), stored(second)], EXPECTED)]
    total, interval = row.regret.total, estimate_mean([gaps]).interval()
    assert (total.mean, total.low, total.high) == (1.125, 0.625, 1.625)
    assert (total.overall.low, total.overall.high) == (interval.low, interval.high)
    assert [one.regret.total.mean for one in row.trainings] == [0.625, 1.625]


def test_tables_have_regret_with_its_parts_and_unit(known):
    results = [
        result_with("anna", [3.0, 5.0, 5.0, 6.0], [1.0, 0.5, 0.0, 2.0]),
        result_with("stranger", [1.0, 2.0, 3.0, 4.0], [0.0] * 4, first_seed=100),
    ]
    (table,) = rank(map(stored, results), EXPECTED)
    assert (table.best_known.agent, table.best_known.reward, table.best_known.epi) == ("champion", 5.375, 5.75)
    text = to_markdown([table], {})
    assert "Regret, profit [EUR/m²]" in text
    assert "It is no bound" in text
    assert "Regret" in to_latex(table)
    frame = to_frame([table]).set_index("agent")
    assert frame.loc["anna", "regret_unit"] == "EUR m-2"
    names = ["regret_mean", "regret_profit_mean [EUR m-2]", "regret_violations_mean"]
    assert list(frame.loc["anna", names]) == [1.5, 1.0, 0.5]
    assert frame.loc["stranger", names].isna().all()
    assert json.loads(to_json([table]))["tasks"][0]["rows"][0]["regret"]["total"]["mean"] == 1.5


def test_a_comparison_has_the_regrets_of_both_in_their_common_runs(known):
    ours = result_with("a", [3.0, 5.0, 5.0, 6.0], [1.0, 0.5, 0.0, 2.0])
    theirs = result_with("b", [5.0, 5.0, 6.0], [0.0, 0.0, 0.0])
    pair = compare_entries(*(entry_of(stored(one)) for one in (ours, theirs)))
    # In the first three runs: 1.5, 0.5 and 0 against -1.5, 0 and -1.
    total = pair.regret["total"]
    assert (total.first, total.second) == pytest.approx((2.0 / 3, -2.5 / 3))
    assert total.difference.value == pytest.approx(1.5)
    assert total.difference.value == pytest.approx(-pair.headline)
    assert total.first == pytest.approx(pair.regret["profit"].first + pair.regret["violations"].first)


def test_the_best_known_is_the_best_of_each_seed_among_those_who_act_through_the_actuation():
    results = [
        result_with("anna", [1.0, 9.0, 1.0, 9.0], [0.0] * 4),
        result_with("bert", [5.0, 5.0, 5.0, 5.0], [0.0] * 4),
        result_with("rule_based", [50.0] * 4, [0.0] * 4, privileged=True),
        result_with("hasty", [70.0] * 3, [0.0] * 3),
        result_with("stranger", [70.0] * 4, [0.0] * 4, task_digest=digest_of("other")),
        result_with("sealed", [70.0] * 4, [0.0] * 4, salt_commitment=digest_of("salt")),
    ]
    found = best_known_from(map(stored, results), EXPECTED)[TASK]
    assert [(run.seed, run.reward, run.agent) for run in found.runs] == [
        (666, 5.0, "bert"), (667, 9.0, "anna"), (668, 5.0, "bert"), (669, 9.0, "anna")
    ]  # fmt: skip
    assert found.agent == "several"
    assert found.agents == {one.agent.name: one.results_digest for one in results[:2]}
    assert found.task_digest == digest_of("meadow")


@pytest.mark.parametrize("planned", [2, 4])
def test_where_only_the_first_runs_have_plans_these_alone_have_best_known_runs(monkeypatch, planned):
    monkeypatch.setattr("glbench.leaderboard.regret._acts_through_actuation", lambda name: name == "planner")
    plans = result_with("planner", [8.0] * planned, [0.0] * planned, privileged=True)
    plans = plans.model_copy(update={"agent": plans.agent.model_copy(update={"kind": "baseline"})})
    results = [
        result_with("anna", [1.0, 9.0, 1.0, 9.0], [0.0] * 4),
        result_with("hasty", [8.5, 1.0], [0.0] * 2),  # two runs, no plan: it counts where plans of two are known
        result_with("other_runs", [70.0] * 2, [0.0] * 2, first_seed=668),  # not the first ones
        plans,
    ]
    expected_runs = {
        2: [(666, 8.5, "hasty"), (667, 9.0, "anna")],
        4: [(666, 8.0, "planner"), (667, 9.0, "anna"), (668, 8.0, "planner"), (669, 9.0, "anna")],
    }
    known = best_known_from(map(stored, results), EXPECTED)[TASK]
    assert [(run.seed, run.reward, run.agent) for run in known.runs] == expected_runs[planned]
    scale = References(zero=-2.0, zero_agent="do_nothing", zero_results_digest="")
    ends = references_from(map(stored, results), EXPECTED, {TASK: scale})[TASK]
    assert ends == scale, "plans of some runs are no end of a scale, nor are plans of which one run is not the best"


def test_regrets_of_first_runs_say_so(home):
    known = stored_known(tuple(KnownRun(seed=seed, reward=8.0, epi=8.0, penalty=0.0, agent="champion") for seed in SEEDS[:2]))
    result = result_with("anna", [9.0, 6.0, 1.0, 1.0], [0.0] * 4)
    regret = regret_of([result])
    assert (regret.runs, regret.total.mean, regret.runs_ahead) == (2, 0.5, 1)
    (table,) = rank([stored(result)], EXPECTED)
    first, better = regret_notes(table)
    assert first == "Regrets are means over the first 2 runs of the task; no plans are known for the others."
    assert "in 1 of the 2 runs that have one" in better
    assert first in to_markdown([table], {})
    assert (table.best_known.runs, to_frame([table]).loc[0, "regret_runs"]) == (len(known.runs), 2)
    pair = compare_entries(*(entry_of(stored(one)) for one in (result, result_with("b", [7.0] * 3, [0.0] * 3))))
    assert (pair.runs, pair.regret_runs, pair.regret["total"].first, pair.regret["total"].second) == (3, 2, 0.5, 1.0)


def test_a_privileged_controller_of_glbench_counts_where_it_acts_through_the_actuation(monkeypatch):
    record = make_result("seer", [1.0], privileged=True).agent
    ours = record.model_copy(update={"kind": "baseline"})
    from glbench.leaderboard import regret

    sights = {"seer": "scenario", "rule_based": "state"}
    monkeypatch.setattr("glbench.agents.baselines.shipped_sight", lambda name: sights[name])
    regret._acts_through_actuation.cache_clear()
    assert can_be_best_known(ours)
    assert not can_be_best_known(record), "a submission cannot be one"
    assert not can_be_best_known(ours.model_copy(update={"name": "rule_based"}))
    regret._acts_through_actuation.cache_clear()


def test_the_one_of_normalised_scores_is_the_mean_of_the_best_known_runs():
    results = [
        result_with("do_nothing", [0.0] * 4, [1.0] * 4),
        result_with("anna", [1.0, 9.0, 1.0, 9.0], [0.0] * 4),
        result_with("bert", [5.0] * 4, [0.0] * 4),
    ]
    old = References(zero=-2.0, zero_agent="do_nothing", zero_results_digest="", best=6.0, best_agent="x", best_results_digest="")
    found = references_from(map(stored, results), EXPECTED, {TASK: old})[TASK]
    assert (found.zero, found.best, found.best_agent, found.version) == (-2.0, 7.0, "several", 2)
    assert found.best_results_digest == f"{results[1].results_digest} {results[2].results_digest}"


@pytest.mark.parametrize(("unit", "has"), [("EUR m-2", True), ("-", False)])
def test_a_suite_has_a_mean_regret_where_all_its_tasks_count_money(known, unit, has):
    other = known.model_copy(update={"task": "glbench/Lawn-v1", "units": MONEY | {"reward": unit}})
    tasks, best = (TASK, "glbench/Lawn-v1"), {TASK: known, "glbench/Lawn-v1": other}
    scores = {
        TASK: {"anna": np.array([2.5, 4.0, 4.0, 7.0]), "half": np.array([0.0] * 4)},  # 1 below everywhere
        "glbench/Lawn-v1": {"anna": np.array([0.5, 2.0, 2.0, 5.0])},  # 3 below
    }
    reference = References(zero=0.0, zero_agent="do_nothing", zero_results_digest="", best=6.0, best_agent="x", plans=True)
    table = suite_table("gardens", tasks, scores, dict.fromkeys(tasks, reference), (), best)
    anna, half = table.rows
    assert half.regret is None
    assert ("Regret [EUR/m²]" in "\n".join(suite_markdown(table))) == has
    if has:
        assert (anna.regret.value, anna.regret.low, anna.regret.high) == (2.0, 2.0, 2.0)
        assert suite_frame([table]).loc[0, "regret [EUR m-2]"] == 2.0
    else:
        assert anna.regret is None
    without = suite_table("gardens", tasks, scores, dict.fromkeys(tasks, reference), (), {TASK: known})
    assert without.rows[0].regret is None, "one task has no best known runs"


def test_best_known_runs_are_written_a_line_a_run_and_read_again(known, home):
    text = (home / "Meadow-v1.json").read_text(encoding="utf-8")
    assert sum('"seed":' in line for line in text.splitlines()) == 4
    assert read_best_known(TASK) == known
    assert read_best_known("mylab/Meadow-v1") is None
    assert known.of([669, 666]) == (known.runs[3], known.runs[0])
    assert known.of([666, 1]) == known.runs[:1]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"seed":667', '"seed":666', "order of their seeds"),
        ('"champion": "', '"nobody": "', "agents are not those of the runs"),
        ('"penalty": "', '"fines": "', "units are not those"),
        ('"runs"', '"walks"', "glbench tasks references --write"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_what_to_do(known, home, old, new, words):
    path = home / "Meadow-v1.json"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(TaskError, match=words):
        read_best_known(TASK)


def test_what_is_shipped_follows_from_the_released_results():
    released, expected = collect_results([data_folder("reports/released/results")]), published_expectations()
    known = best_known_from(released, expected)
    assert {task_id: read_best_known(task_id) for task_id in known} == known
    files = {path.stem for path in references_module.best_known_path(TASK).parent.glob("*.json")}
    assert files == {task_id.rpartition("/")[2] for task_id in known}
    assert dict(read_references()) == references_from(released, expected, read_references())
    for task_id, one in read_references().items():
        if (
            one.zero_agent in ("outdoor", "rule_based_harvest_46") and not one.plans
        ):  # a newer task, without plans: what agents did themselves is no end of a scale
            assert (one.best, one.best_agent) == (None, None)
            continue
        if len(known[task_id].runs) < len(expected[task_id].seeds):  # plans of the first runs are no end of a scale
            assert not one.plans
            continue
        assert one.best == pytest.approx(np.mean([run.reward for run in known[task_id].runs]), rel=1e-12)
        assert one.best_agent == known[task_id].agent


def test_nobody_who_acts_through_the_actuation_is_ahead_of_the_shipped_best_known_and_parts_add_up():
    for item in collect_results([data_folder("reports/released/results") / "Spring-v1"]):
        regret = regret_of([item.result])
        assert regret.total.mean == pytest.approx(regret.profit.mean + regret.violations.mean, abs=1e-9)
        if can_be_best_known(item.result.agent):
            assert regret.runs_ahead == 0


def test_without_plans_and_with_first_runs_only_there_is_no_best_known() -> None:
    expected = {TASK: Expectation(digest_of("meadow"), tuple(range(666, 676)))}
    assert best_known_from([stored(make_result("a", [1.0, 2.0, 3.0]))], expected) == {}
