"""Entries: which results are trainings of one recipe, what is said of them together, and where results come from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glbench.errors import ResultError
from glbench.leaderboard import Expectation, StoredResult, rank, to_frame, to_markdown
from glbench.leaderboard.entries import entries_by_task
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.statistics import aggregate
from glbench.leaderboard.suites import scores_by_task, suite_table
from glbench.leaderboard.tables import agent_label, card_notes, kernel_note, runs_label
from glbench.tasks.references import References
from tests.leaderboard.synthetic import TASK, digest_of

EXPECTED = {TASK: Expectation(digest=digest_of("meadow"), seeds=(666, 667, 668, 669))}


def changed(item: StoredResult, **changes: object) -> StoredResult:
    """The result with other facts about its agent; its file stays as it was."""
    agent = item.result.agent.model_copy(update=changes)
    return replace(item, result=item.result.model_copy(update={"agent": agent}))


@pytest.fixture
def trainings(store):
    """Three trainings of ``ppo``: means 10, 30 and 20, the best in the middle."""
    return [
        store("ppo", [9.0, 10.0, 10.0, 11.0], recipe=("y-ppo", 0)),
        store("ppo_seed1", [29.0, 30.0, 30.0, 31.0], recipe=("y-ppo", 1)),
        store("ppo_seed2", [19.0, 20.0, 20.0, 21.0], recipe=("y-ppo", 2)),
    ]


def entries(stored):
    return entries_by_task(stored, EXPECTED)[TASK]


def test_trainings_make_one_row_with_mean_and_range(trainings):
    ((row,),) = [table.rows for table in rank(trainings, EXPECTED)]
    assert (row.agent, row.rank, len(row.trainings)) == ("ppo", 1, 3)
    reward = row.estimates["reward"]
    assert (reward.mean, reward.low, reward.high) == (20.0, 10.0, 30.0)
    assert agent_label(row).startswith("ppo (3 trainings)")
    assert runs_label(row) == "3 × 4"


def test_the_first_training_is_that_with_the_lowest_seed_and_not_the_best(trainings):
    ((row,),) = [table.rows for table in rank(reversed(trainings), EXPECTED)]
    assert [(one.agent, one.training_seed) for one in row.trainings] == [("ppo", 0), ("ppo_seed1", 1), ("ppo_seed2", 2)]
    assert row.results_digest == trainings[0].result.results_digest


def test_folders_of_glbench_train_are_trainings_too(store):
    """They name no authors, so the rest of their names has to be the same as well."""
    stored = [
        store(f"{name}-seed{seed}", [float(seed)] * 4, recipe=("ppo-0123456789abcdef", seed), authors=None)
        for name in ("ppo-Meadow-v1", "eve")
        for seed in (10, 2)
    ]
    first, second = entries(stored)
    assert (first.name, first.training_seeds) == ("eve", (2, 10))
    assert (second.name, second.training_seeds) == ("ppo-Meadow-v1", (2, 10))


def test_a_name_alone_joins_nobody(store):
    """``zed`` and ``zed_seed1`` of different authors are two rows, whatever they earn."""
    (table,) = rank([store("zed", [-15.1] * 4), store("zed_seed1", [-198.5] * 4)], EXPECTED)
    assert [(row.agent, row.trainings) for row in table.rows] == [("zed", ()), ("zed_seed1", ())]


@pytest.mark.parametrize(
    "forged",
    [
        {"authors": ("eve",)},
        {"authors": ("y", "eve")},
        {"authors": ("\u0443",)},  # a Cyrillic letter
        {"authors": None},
        {"recipe": ("Y-ppo", 3)},
        {"policy": "policy of ppo_seed1"},
        {"privileged": True},
    ],
    ids=str,
)
def test_a_forged_training_changes_nobodys_row(store, trainings, forged):
    more = {"recipe": ("y-ppo", 3)} | forged
    stranger = store("ppo_seed3", [-900.0] * 4, **more)
    found = entries([*trainings, stranger])
    assert [(entry.name, len(entry.trainings)) for entry in found] == [("ppo", 3), ("ppo_seed3", 1)]
    assert found[0] == entries(trainings)[0]


def test_one_policy_under_three_names_and_cards_is_one_training(store):
    """Nor does it become two by another seed: the weights are the same."""
    stored = [store(name, [5.0] * 4, recipe=("mine", seed), policy="one") for seed, name in enumerate(("a", "b", "a_seed2"))]
    assert [(entry.name, entry.training_seeds) for entry in entries(stored)] == [("a", ()), ("a_seed2", ()), ("b", ())]
    other = store("c", [6.0] * 4, recipe=("mine", 7))
    found = entries([*stored, other])
    assert [(entry.name, entry.training_seeds) for entry in found] == [("a", (0, 7)), ("a_seed2", ()), ("b", ())]


def test_where_no_file_holds_weights_the_runs_tell_policies_apart(store):
    def without_weights(name: str, seed: int, reward: float) -> StoredResult:
        item = store(name, [reward] * 4, recipe=("mine", seed))
        assert item.result.agent.training is not None
        return changed(item, training=item.result.agent.training.model_copy(update={"policy": None}))

    found = entries([without_weights("a", 0, 1.0), without_weights("b", 1, 1.0), without_weights("c", 2, 2.0)])
    assert [(entry.name, entry.training_seeds) for entry in found] == [("a", (0, 2)), ("b", ())]


def test_weights_that_decide_the_same_are_one_policy_whatever_their_bytes(store):
    padded = [store(name, [5.0, 6.0], recipe=("mine", seed), policy=name) for seed, name in enumerate(("a", "b"))]
    other = store("c", [6.0, 6.5], recipe=("mine", 7), policy="c")
    found = entries([*padded, other])
    assert [(entry.name, entry.training_seeds) for entry in found] == [("a", (0, 7)), ("b", ())]


def test_an_entry_takes_no_name_that_another_agent_has(store):
    mine = [store(f"zed_seed{seed}", [float(seed)] * 4, recipe=("mine", seed)) for seed in (1, 2)]
    assert [entry.name for entry in entries(mine)] == ["zed"]
    assert [entry.name for entry in entries([*mine, store("zed", [9.0] * 4)])] == ["zed", "zed_seed1"]


def test_a_suite_holds_results_of_one_agent_and_not_of_one_name(store):
    """Two versions of ``zed``: that of most tasks counts, of equally many the latest."""
    tasks = [f"glbench/{name}-v1" for name in ("Bog", "Field", "Meadow")]
    expected = dict.fromkeys(tasks, EXPECTED[TASK])
    old = [store("zed", [float(n)] * 4, task_id=task) for n, task in enumerate(tasks)]
    new = changed(store("zed", [9.0] * 4, task_id=tasks[0], created="2026-02-01T00:00:00Z"), digest=digest_of("new"))
    scores = scores_by_task([new, *old[1:]], expected)
    assert ["zed" in scores.get(task, {}) for task in tasks] == [False, True, True]
    scores = scores_by_task([new, old[1]], expected)
    assert ["zed" in scores.get(task, {}) for task in tasks[:2]] == [True, False]


def test_shipped_trainings_are_joined_by_the_cards_that_came_with_glbench(store, monkeypatch):
    names = ("ppo_fast", "ppo_fast_seed1", "ppo_fast_seed2", "ppo_fast_seed7", "ppo_tuned")
    stored = [changed(store(name, [float(place)] * 4), kind="baseline") for place, name in enumerate(names)]
    assert all(len(entry.trainings) == 1 for entry in entries(stored)), "their digests are not those that are shipped"
    monkeypatch.setattr(StoredResult, "released", property(lambda self: True))
    found = [(entry.name, entry.training_seeds) for entry in entries(stored)]
    assert found == [("ppo_fast", (0, 1, 2)), ("ppo_fast_seed7", ()), ("ppo_tuned", ())]


def test_another_kind_or_origin_is_no_training_of_the_entry(store, trainings, monkeypatch):
    stranger = changed(store("ppo_seed3", [90.0] * 4, recipe=("y-ppo", 3)), kind="baseline")
    assert [entry.name for entry in entries([*trainings, stranger])] == ["ppo", "ppo_seed3"]
    released = {item.path for item in trainings}
    monkeypatch.setattr(StoredResult, "released", property(lambda self: self.path in released))
    own = store("ppo_seed4", [90.0] * 4, recipe=("y-ppo", 4))
    found = entries([*trainings, own])
    assert [(entry.name, entry.origin, len(entry.trainings)) for entry in found] == [("ppo", "released", 3), ("ppo_seed4", "own", 1)]


def test_results_that_claim_to_be_the_same_training_stay_apart(store, trainings):
    found = entries([*trainings, store("ppo-seed1", [90.0] * 4, recipe=("y-ppo", 1))])
    assert [entry.name for entry in found] == ["ppo", "ppo-seed1", "ppo_seed1", "ppo_seed2"]


def test_where_a_task_has_one_of_several_trainings_the_row_says_so(store, trainings):
    other = store("ppo", [1.0] * 4, task_id="glbench/Field-v1", recipe=("y-ppo", 0))
    field, meadow = rank([*trainings, other, store("rule", [0.0] * 4)], {})
    assert agent_label(field.rows[0]).startswith("ppo (1 training)")
    assert [agent_label(row).split()[0] for row in meadow.rows] == ["ppo", "rule"]
    assert "training" not in agent_label(meadow.rows[1])


def test_a_trial_is_shown_as_one_beside_the_full_result(store, monkeypatch):
    full = store("rule", [1.0, 2.0, 3.0, 4.0])
    monkeypatch.setattr(StoredResult, "released", property(lambda self: self.path == full.path))
    trial = store("rule", [9.0, 9.0], folder="elsewhere")
    (table,) = rank([trial, full, store("mine", [-99.0, -98.0, -97.0, -96.0])], EXPECTED)
    assert [(row.agent, row.origin, row.rank) for row in table.rows] == [
        ("rule", "released", 1),
        ("mine", "own", 2),
        ("rule (trial)", "trial", None),
    ]
    assert list(to_frame([table])["origin"]) == ["released", "own", "trial"]
    text = to_markdown([table], {})
    assert "| Source |" in text
    assert "| trial |" in text


def test_an_entry_is_compared_by_the_mean_over_its_trainings_and_by_what_they_differ(store, trainings):
    (entry,) = entries(trainings)
    np.testing.assert_allclose(entry.values("reward"), [19.0, 20.0, 20.0, 21.0])
    (other,) = entries([store("rule", [18.0, 19.0, 19.0, 20.0])])
    pair = compare_entries(entry, other)
    assert pair.trainings == (3, 1)
    difference = pair.metrics["reward"].difference
    assert difference.value == 1.0
    # Means 10, 30 and 20: 1 +- 4.303 sqrt(100/3); the rule states no training, so it does not vary.
    assert difference.high - 1.0 == pytest.approx(4.302653 * np.sqrt(100.0 / 3.0), rel=1e-6)
    # The first training is behind in every run, the second and the third are ahead.
    assert pair.improvement.value == pytest.approx(2 / 3)


def test_a_board_names_trainings_that_cards_alone_join(store, trainings):
    (table,) = rank(trainings, EXPECTED)
    assert not card_notes(table)
    (table,) = rank([*trainings[:2], store("stranger", [1.0, 2.0, 2.0, 3.0], recipe=("y-ppo", 2))], EXPECTED)
    assert card_notes(table)[0].startswith("ppo is ppo, ppo_seed1 and stranger: their cards state the same recipe")


def test_exports_keep_every_training_with_its_entry(trainings):
    frame = to_frame(rank(trainings, EXPECTED))
    assert list(frame["agent"]) == ["ppo", "ppo_seed1", "ppo_seed2"]
    assert set(frame["entry"]) == {"ppo"}
    assert list(frame["training_seed"]) == [0, 1, 2]
    assert list(frame["reward_mean [-]"]) == [10.0, 30.0, 20.0]
    for part, value in (("mean", 20.0), ("lowest", 10.0), ("highest", 30.0)):
        assert set(frame[f"entry_reward_{part} [-]"]) == {value}


def test_over_a_suite_trainings_have_a_range_and_all_their_runs_count(trainings):
    references = {
        TASK: References(zero=0.0, zero_agent="do_nothing", zero_results_digest="", best=40.0, best_agent="x", best_results_digest="")
    }
    scores = scores_by_task(trainings, EXPECTED)
    assert scores[TASK]["ppo"].shape == (3, 4)
    table = suite_table("meadows", (TASK,), scores, references, rank(trainings, EXPECTED))
    assert table is not None
    (row,) = table.rows
    assert (row.trainings, row.runs) == ((3, 3), 12)
    assert (row.optimality_gap.value, row.optimality_gap.low, row.optimality_gap.high) == (0.5, 0.25, 0.75)
    # Means 0.25, 0.75 and 0.5: 0.5 +- 4.303 sqrt(0.0625/3); runs differ by less than what trainings do.
    assert (row.mean.value, row.mean.high - 0.5) == (0.5, pytest.approx(4.302653 * np.sqrt(0.0625 / 3.0), rel=5e-3))
    assert row.figures is not None
    assert row.figures.origin == "own"


def test_the_gap_of_the_lowest_training_is_the_upper_end():
    found = aggregate([np.array([[0.2, 0.2], [0.6, 0.6]])], "optimality_gap")
    assert (found.low, found.high) == (pytest.approx(0.4), pytest.approx(0.8))


def test_the_metric_of_the_task_ranks(store):
    def with_profit(agent: str, reward: float, epi: float) -> StoredResult:
        item = store(agent, [reward] * 4)
        runs = tuple(run.model_copy(update={"metrics": {**run.metrics, "epi": epi + 0.01 * i}}) for i, run in enumerate(item.result.runs))
        return replace(item, result=item.result.model_copy(update={"runs": runs}))

    stored = [with_profit("rich", 1.0, 9.0), with_profit("tidy", 100.0, 2.0)]
    (by_reward,) = rank(stored, EXPECTED)
    (by_profit,) = rank(stored, {TASK: replace(EXPECTED[TASK], metric="epi")})
    assert [row.agent for row in by_reward.rows] == ["tidy", "rich"]
    assert [row.agent for row in by_profit.rows] == ["rich", "tidy"]
    assert by_profit.metric == "epi"
    assert "| # | Agent | EPI [EUR/m²] | Reward |" in to_markdown([by_profit], {})


@pytest.mark.parametrize("metric", ["penalty", "beauty"])
def test_a_metric_that_cannot_rank_is_refused(store, metric):
    with pytest.raises(ResultError, match=f"ranking by '{metric}'"):
        rank([store("a", [1.0] * 4)], {TASK: replace(EXPECTED[TASK], metric=metric)})


def test_two_builds_of_one_preset_are_told_apart(store):
    def stepped(agent: str, library: str, **more: str) -> StoredResult:
        item = store(agent, [float(len(agent))] * 4)
        kernel = {"backend": "compiled", "preset": "reference", "library_digest": library * 64, **more}
        evaluation = item.result.evaluation.model_copy(update={"kernel": kernel})
        return replace(item, result=item.result.model_copy(update={"evaluation": evaluation}))

    (same,) = rank([stepped("a", "1"), stepped("bb", "1")], EXPECTED)
    assert kernel_note(same) == ""
    (builds,) = rank([stepped("a", "1"), stepped("bb", "2"), stepped("ccc", "1")], EXPECTED)
    assert kernel_note(builds).startswith("Two kernel builds: 111111 (ccc, a), 222222 (bb).")
    (methods,) = rank([stepped("a", "1"), stepped("bb", "1", method="Rodas3")], EXPECTED)
    assert kernel_note(methods).startswith("Two kernel builds: 111111.")


def test_trainings_that_failed_count_in_the_mean_of_their_recipe(store):
    scores = [[10.0 + seed, 11.0 + seed] if seed < 2 else [-1000.0, -1000.0] for seed in range(5)]
    names = ["z", *(f"z_seed{seed}" for seed in range(1, 5))]
    trainings = [
        store(name, values, recipe=("z", seed), crashed=2 if seed >= 2 else 0)
        for seed, (name, values) in enumerate(zip(names, scores, strict=True))
    ]
    (table,) = rank(trainings, {})
    (row,) = table.rows
    assert (len(row.results), row.failed, row.means["reward"]) == (5, 6, pytest.approx(np.mean(scores)))
