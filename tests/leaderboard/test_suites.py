"""Agents over several tasks: normalised between doing nothing and the best known result."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.errors import TaskError
from glbench.leaderboard import Expectation, StoredResult, rank, statistics
from glbench.leaderboard.suites import references_from, scores_by_task, suite_table
from glbench.leaderboard.tables import suite_frame, suite_markdown
from glbench.tasks import references as references_module
from glbench.tasks.references import References, read_references, write_references
from tests.leaderboard.synthetic import digest_of

SEEDS = tuple(range(666, 696))
TASKS = ("glbench/A-v1", "glbench/B-v1")
EXPECTED = {task: Expectation(digest_of(task), SEEDS) for task in TASKS}
REFERENCES = {
    "glbench/A-v1": References(
        zero=0.0, zero_agent="do_nothing", zero_results_digest="", best=100.0, best_agent="x", best_results_digest=""
    ),
    "glbench/B-v1": References(
        zero=1000.0, zero_agent="do_nothing", zero_results_digest="", best=3000.0, best_agent="x", best_results_digest=""
    ),
}


NEW = {TASKS[0]: References(zero_agent="outdoor")}


@pytest.fixture
def stored(store):
    """Three agents; ``patchy`` lacks the second task, ``short`` some runs of the first."""
    noise = np.random.default_rng(0).normal(0.0, 1.0, 30)

    def save(agent, task, level, runs=30):
        return store(agent, list(level + noise[:runs]), task_id=task, task_digest=digest_of(task))

    return [
        save("good", TASKS[0], 80.0),
        save("good", TASKS[1], 2600.0),
        save("poor", TASKS[0], 20.0),
        save("poor", TASKS[1], 1200.0),
        save("patchy", TASKS[0], 90.0),
        save("short", TASKS[0], 95.0, runs=10),
    ]


def test_scores_are_those_of_complete_results(stored):
    scores = scores_by_task(stored, EXPECTED)
    assert set(scores[TASKS[0]]) == {"good", "poor", "patchy"}
    assert set(scores[TASKS[1]]) == {"good", "poor"}


def test_a_suite_ranks_agents_that_have_all_tasks_and_lists_the_others_with_what_they_lack(stored):
    table = suite_table("s", TASKS, scores_by_task(stored, EXPECTED), REFERENCES)
    assert [(row.agent, row.rank, row.missing) for row in table.rows] == [("good", 1, ()), ("poor", 2, ()), ("patchy", None, (TASKS[1],))]
    # 80/100 and 1600/2000
    assert table.rows[0].mean.value == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize(
    ("seeds", "rows"),
    [
        (((0, 1, 2), (0, 1, 2)), ((0, 1, 2), (0, 1, 2))),
        (((0, 2, 4), (0, 1, 2)), ((0, 2, 4), (0, 2, 1))),
        (((0, 1, 2, 3, 4), (2, 3, 4)), ((2, 3, 4, 0, 1), (2, 3, 4))),
        (((5, 6), (0, 5)), ((5, 6), (5, 0))),
        (((0, 3, 7), (7,)), ((0, 3, 7), (7,))),
    ],
)
def test_trainings_with_one_seed_are_in_one_row_of_all_tasks(store, seeds, rows):
    """The level of a training is its seed, so that the rows tell it."""
    noise = np.random.default_rng(1).normal(0.0, 0.01, (2, 10, 30))
    trained = [
        store(
            f"anna_seed{seed}",
            list(seed + noise[task, seed]),
            task_id=TASKS[task],
            task_digest=digest_of(TASKS[task]),
            recipe=("anna", seed),
        )
        for task, of_task in enumerate(seeds)
        for seed in of_task
    ]
    scores = scores_by_task(trained, EXPECTED)
    assert [tuple(np.rint(scores[task]["anna"].mean(axis=1)).astype(int)) for task in TASKS] == list(rows)
    if seeds[0] != (0, 2, 4):
        return
    # Rows of one seed on both tasks vary together: seeds 0 and 2 in the first two rows, 4 and 1 in the third.
    over_both = statistics.estimate_mean([scores[task]["anna"] for task in TASKS])
    assert over_both.variance == pytest.approx(np.var([0.0, 2.0, 2.5], ddof=1) / 3, rel=0.02)


def test_without_references_there_is_no_suite_table(stored):
    assert suite_table("s", TASKS, scores_by_task(stored, EXPECTED), {}) is None


def of_outdoor(store, seeds, level=5.0):
    noise = np.random.default_rng(2).normal(0.0, 1.0, (len(seeds), 30))
    names = {"task_id": TASKS[0], "task_digest": digest_of(TASKS[0])}
    return [store(f"outdoor_seed{seed}", list(level + noise[i]), recipe=("outdoor", seed), **names) for i, seed in enumerate(seeds)]


def test_zero_of_a_new_task_is_the_mean_of_five_trainings_and_names_them(stored, store):
    trainings = of_outdoor(store, range(5))
    found = references_from([*stored, *trainings], EXPECTED, NEW)[TASKS[0]]
    assert found.zero == pytest.approx(np.mean([item.result.values("reward") for item in trainings]), rel=1e-12)
    assert (found.zero_agent, found.version) == ("outdoor", 1)
    assert found.zero_results_digest.split() == [item.result.results_digest for item in trainings]
    assert (found.plans, found.best, found.ends) == (False, None, None), "no plans are known, so there is no one"


@pytest.mark.parametrize("seeds", [range(4), ()])
def test_a_new_task_has_no_scale_without_five_trainings_of_the_agent_that_is_zero(stored, store, seeds):
    assert references_from([*stored, *of_outdoor(store, seeds)], EXPECTED, NEW) == NEW
    assert NEW[TASKS[0]].ends is None


def test_plans_that_know_the_season_make_the_one_of_a_new_task(stored, store):
    plan = store("plan", [200.0] * 30, task_id=TASKS[0], task_digest=digest_of(TASKS[0]), privileged=True)
    agent = plan.result.agent.model_copy(update={"name": "best_known", "kind": "baseline"})
    plan = StoredResult(plan.path, plan.result.model_copy(update={"agent": agent}))
    found = references_from([*stored, plan, *of_outdoor(store, range(5))], EXPECTED, NEW)[TASKS[0]]
    assert (found.plans, found.best, found.best_agent) == (True, 200.0, "best_known")


def test_a_stored_zero_is_kept_and_a_move_of_one_raises_the_version(stored, store):
    before = {TASKS[0]: REFERENCES[TASKS[0]].model_copy(update={"best": 1.0})}
    items = [*stored, store("do_nothing", [5.0] * 30, task_id=TASKS[0], task_digest=digest_of(TASKS[0]))]
    first = references_from(items, EXPECTED, before)[TASKS[0]]
    assert (first.zero, first.zero_agent, first.best_agent, first.version) == (0.0, "do_nothing", "patchy", 2)
    assert references_from(items, EXPECTED, {TASKS[0]: first})[TASKS[0]] == first, "nothing moved"


def test_tasks_without_an_entry_get_none(stored):
    assert references_from(stored, EXPECTED, {}) == {}


def test_references_are_written_and_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(references_module, "references_path", lambda: tmp_path / "references.toml")
    read_references.cache_clear()
    without_one = References(zero=3.0, zero_agent="outdoor", zero_results_digest="a b", version=4)
    references = {**REFERENCES, "glbench/C-v1": without_one, "glbench/D-v1": References(zero_agent="outdoor")}
    write_references(references)
    assert read_references() == references
    read_references.cache_clear()


def test_references_in_the_wrong_order_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "references.toml"
    monkeypatch.setattr(references_module, "references_path", lambda: path)
    write_references(REFERENCES)
    path.write_text(path.read_text().replace("best = 100.0", "best = -1.0"))
    with pytest.raises(TaskError, match="not above that of do_nothing"):
        read_references()
    read_references.cache_clear()


def test_every_ordered_pair_has_a_probability_of_improvement_and_the_two_add_up_to_one(stored):
    table = suite_table("s", TASKS, scores_by_task(stored, EXPECTED), REFERENCES)
    odds = {(one.first, one.second): one.probability for one in table.improvements}
    assert set(odds) == {("good", "poor"), ("poor", "good")}
    assert odds["good", "poor"].value + odds["poor", "good"].value == 1.0
    assert odds["good", "poor"].value == 1.0


def test_profiles_fall_from_all_runs_to_none_over_the_same_thresholds(stored):
    table = suite_table("s", TASKS, scores_by_task(stored, EXPECTED), REFERENCES)
    assert {profile.agent for profile in table.profiles} == {"good", "poor"}
    for profile in table.profiles:
        assert profile.thresholds == table.profiles[0].thresholds
        assert (profile.share[0], profile.share[-1]) == (1.0, 0.0)
        assert (np.diff(profile.share) <= 0.0).all()


def test_resources_are_means_over_the_tasks(stored):
    tables = rank(stored, EXPECTED)
    table = suite_table("s", TASKS, scores_by_task(stored, EXPECTED), REFERENCES, tables)
    good = table.rows[0].figures
    means = [row.estimates["heat"].mean for one in tables for row in one.rows if row.agent == "good"]
    assert good.metrics["heat"] == pytest.approx(np.mean(means))
    assert (good.runs, good.failed, good.sandbox, good.training_steps) == (60, 0, "bubblewrap", None)
    frame = suite_frame([table])
    assert list(frame["agent"]) == ["good", "poor", "patchy"]
    assert frame.loc[0, "heat_mean [kWh m-2]"] == pytest.approx(np.mean(means))
    text = "\n".join(suite_markdown(table))
    assert "| patchy |" in text
    assert "lacks 1 task" in text
    assert "Probability of improvement" in text
