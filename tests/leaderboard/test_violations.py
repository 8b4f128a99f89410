"""Orders at other prices of violations, the frontier, and how sure the order of neighbours is; over a task, and over suites in money."""

from __future__ import annotations

import json

import numpy as np
import pytest

from glbench.leaderboard import Expectation, rank, statistics, to_frame, to_markdown
from glbench.leaderboard.suites import RULES, scores_by_task, suite_table
from glbench.leaderboard.tables import missing_notes, suite_frame, suite_markdown, to_json, turn_notes
from glbench.leaderboard.violations import at_prices, scores_at
from glbench.tasks.references import References
from tests.leaderboard.synthetic import digest_of, make_result, result_with, stored

TASKS = ("glbench/A-v1", "glbench/B-v1")
SEEDS = tuple(range(666, 676))
EXPECTED = {task: Expectation(digest_of(task), SEEDS) for task in TASKS}
NOISE = np.random.default_rng(3).normal(0.0, 0.02, (6, len(SEEDS)))
SCALE = References(
    zero=0.0, zero_agent="outdoor", zero_results_digest="", best=10.0, best_agent="best_known", best_results_digest="", plans=True
)


def result(agent, profit, violations, task=TASKS[0], place=0, **more):
    """One whose profits and penalties have means close to these [EUR m-2]: noise is drawn by ``place`` and adds up to zero."""
    noise = NOISE[place] - NOISE[place].mean()
    epi, penalty = list(profit + noise), list(violations + 0.0 * noise)
    return stored(result_with(agent, epi, penalty, task_id=task, task_digest=digest_of(task), **more))


@pytest.fixture
def items():
    """``careful`` and ``bold`` change places at 1 + 0.5 / (1 - 2.5) = 2/3 of the price; ``clumsy`` is beaten; ``seer`` is privileged."""
    return [
        result("careful", 5.0, 1.0, place=0),
        result("bold", 6.0, 2.5, place=1),
        result("clumsy", 5.5, 3.0, place=2),
        result("seer", 9.0, 0.0, place=3, privileged=True),
    ]


def test_ranks_and_means_at_half_and_double_the_price(items):
    (table,) = rank(items, EXPECTED)
    places = {row.agent: [(one.factor, one.rank, round(one.mean, 9)) for one in row.at_prices] for row in table.rows}
    assert places["careful"] == [(0.5, 3, 4.5), (1.0, 2, 4.0), (2.0, 2, 3.0)]
    assert places["bold"] == [(0.5, 2, 4.75), (1.0, 3, 3.5), (2.0, 3, 1.0)]
    assert places["clumsy"] == [(0.5, 4, 4.0), (1.0, 4, 2.5), (2.0, 4, -0.5)]
    assert [one[1] for one in places["seer"]] == [1, 1, 1]


def test_at_the_price_of_the_task_scores_have_the_same_bits():
    rewards, penalties = [NOISE[0] / 3.0], [NOISE[1] / 7.0]
    assert scores_at(rewards, penalties, 1.0)[0].tobytes() == rewards[0].tobytes()


def test_trainings_count_by_their_mean_at_every_price():
    of_recipe = [result(f"anna_seed{seed}", 4.0 + seed, 1.0 + seed, place=seed, recipe=("anna", seed)) for seed in range(3)]
    (table,) = rank([*of_recipe, result("bert", 1.0, 0.0, place=4)], EXPECTED)
    anna = next(row for row in table.rows if row.agent == "anna")
    assert [round(one.mean, 9) for one in anna.at_prices] == [4.0, 3.0, 1.0], "profit 5, violations 2"


def test_who_changes_places_is_named_with_the_factor(items):
    (table,) = rank(items, EXPECTED)
    (turn,) = table.turns
    assert (turn.first, turn.second) == ("careful", "bold")
    assert turn.factor == pytest.approx(2.0 / 3.0, rel=1e-9)
    assert turn_notes(table) == [
        "Orders that hang on the price of violations, and where they turn: that of careful and bold at 0.67 times the price."
    ]
    assert turn_notes(table)[0] in to_markdown([table], {})


def of_two(violations, order):
    """First: reward 4, violations 1. Second: reward 3.5."""
    rewards, penalties = {"a": [np.full(3, 4.0)], "b": [np.full(3, 3.5)]}, {"a": [np.full(3, 1.0)], "b": [np.full(3, violations)]}
    return at_prices(rewards, penalties, order)[1]


def test_agents_that_share_a_rank_are_no_conclusion_that_could_turn():
    assert len(of_two(2.1, [("a",), ("b",)])) == 1
    assert of_two(2.1, [("a", "b")]) == ()


@pytest.mark.parametrize(("violations", "turns"), [(1.9, 0), (2.1, 1), (0.4, 1), (0.6, 0), (1.0, 0)])
def test_only_orders_that_turn_between_half_and_double_the_price_are_named(violations, turns):
    """They turn at 1 + 0.5 / (1 - v): 0.44, 0.55, 1.83, 2.25, never."""
    assert len(of_two(violations, [("a",), ("b",)])) == turns


def test_the_frontier_has_who_is_not_beaten_in_both(items):
    (table,) = rank(items, EXPECTED)
    assert {row.agent: row.frontier for row in table.rows} == {"careful": True, "bold": True, "clumsy": False, "seer": None}
    rewards, penalties = ({agent: [np.full(3, one)] for agent, one in zip("abc", of, strict=True)} for of in ((0, 0, -1.0), (1, 1, 2.0)))
    twins, _ = at_prices(rewards, penalties, [("a", "b"), ("c",)])
    assert [twins[agent]["frontier"] for agent in "abc"] == [True, True, False]


def test_a_task_whose_score_is_no_money_has_no_prices():
    tables = rank([stored(make_result("a", [5.0, 6.0, 7.0])), stored(make_result("b", [1.0, 2.5, 3.0]))], {})
    assert [(row.at_prices, row.frontier) for row in tables[0].rows] == [((), None)] * 2
    assert "Frontier" not in to_markdown(tables, {})


def test_the_order_of_neighbours_reverses_with_half_the_p_value_of_their_test():
    first, second, third = (np.array([3.0, 1.0, 2.0, 4.0]) + shift for shift in (np.array([0.1, 0.5, 0.2, 0.9]), 0.0, 0.0))
    items = [stored(make_result(name, list(values))) for name, values in (("one", first), ("two", second), ("two_again", third))]
    (table,) = rank(items, {})
    expected = statistics.paired_test([first], [second]).p_value / 2.0
    assert [row.reversal for row in table.rows] == [None, expected, 0.5]
    assert 0.01 < expected < 0.1
    assert f"{expected:.2f}" in to_markdown([table], {})


def test_files_hold_places_frontier_and_reversals(items):
    tables = rank(items, EXPECTED)
    frame = to_frame(tables).set_index("agent")
    assert frame.loc["bold", "entry_at_0.5x_rank"] == 2
    assert frame.loc["bold", "entry_at_2x_mean [EUR m-2]"] == pytest.approx(1.0)
    assert list(frame["entry_frontier"].fillna(False)) == [False, True, True, False]
    document = json.loads(to_json(tables))["tasks"][0]
    assert document["turns"][0]["second"] == "bold"
    assert document["rows"][1]["at_prices"][0] == {"factor": 0.5, "rank": 3, "mean": pytest.approx(4.5)}


@pytest.fixture
def both():
    """Two tasks. Normalised by 10 and by 100, ``steady`` leads; in money ``spiky`` does. ``half`` lacks the second task."""
    return [
        *(result("steady", profit, 1.0, task, place) for place, (task, profit) in enumerate(zip(TASKS, (7.0, 11.0), strict=True))),
        *(result("spiky", profit, 2.0, task, 2 + place) for place, (task, profit) in enumerate(zip(TASKS, (4.0, 32.0), strict=True))),
        *(result(RULES, profit, 1.0, task, 4 + place) for place, (task, profit) in enumerate(zip(TASKS, (2.0, 9.0), strict=True))),
        result("half", 8.0, 1.0, TASKS[0], 3),
    ]


def over_both(items, *references):
    scores, penalties = scores_by_task(items, EXPECTED), scores_by_task(items, EXPECTED, "penalty")
    scales = dict(zip(TASKS, references, strict=False))
    return suite_table("s", TASKS, scores, scales, rank(items, EXPECTED), penalties=penalties)


@pytest.mark.parametrize("scales", [(SCALE, SCALE.model_copy(update={"best": 100.0, "plans": False})), (SCALE,), ()])
def test_a_suite_without_plans_on_every_task_is_shown_in_money_with_differences_to_the_rules(both, scales):
    table = over_both(both, *scales)
    assert table.in_money
    assert table.without_plans == (TASKS[1:] if scales else TASKS)
    rows = {row.agent: row for row in table.shown_rows}
    assert list(rows) == ["spiky", "steady", RULES, "half"]
    assert [row.money.rank for row in table.shown_rows] == [1, 2, 3, None]
    assert rows["spiky"].money.mean.value == pytest.approx((2.0 + 30.0) / 2)
    difference = rows["spiky"].money.against_rules
    assert difference.value == pytest.approx((1.0 + 22.0) / 2)
    assert difference.low < difference.value < difference.high
    text = "\n".join(suite_markdown(table))
    assert "no plans are known" in text
    assert "| Mean [EUR/m²] |" in text
    assert "Optimality gap" not in text
    assert "| IQM |" not in text


def test_without_any_scale_nothing_is_normalised_and_files_say_so(both):
    table = over_both(both)
    assert all(row.mean is None and row.iqm is None for row in table.rows)
    assert [row.rank for row in table.rows] == [1, 2, 3, None]
    assert (table.zero, table.profiles) == ((), ())
    frame = suite_frame([table]).set_index("agent")
    assert frame.loc["spiky", "money_rank"] == 1
    assert frame.loc["spiky", "mean"] is None
    assert json.loads(to_json((), [table]))["suites"][0]["rows"][0]["mean"] is None


def test_normalised_ranks_stay_in_the_files_beside_those_in_money(both):
    table = over_both(both, SCALE, SCALE.model_copy(update={"best": 100.0, "plans": False}))
    frame = suite_frame([table]).set_index("agent")
    assert list(frame.loc[["steady", "spiky"], "rank"]) == [1, 2], "0.6 and 0.1 against 0.2 and 0.3"
    assert list(frame.loc[["steady", "spiky"], "money_rank"]) == [2, 1]
    assert frame.loc["steady", "mean"] == pytest.approx((0.6 + 0.1) / 2)


def test_with_plans_on_every_task_scores_are_normalised_and_zero_is_named(both):
    table = over_both(both, SCALE, SCALE.model_copy(update={"best": 100.0, "version": 2}))
    assert not table.in_money
    assert [row.agent for row in table.shown_rows] == ["steady", "spiky", RULES, "half"]
    text = "\n".join(suite_markdown(table))
    assert "0 is the mean of outdoor, 1 the best known result of each task (scale version 1 and 2)" in text
    assert "| IQM |" in text


def test_an_agent_that_lacks_a_task_has_a_row_over_what_it_has(both):
    half = over_both(both).shown_rows[-1]
    assert (half.agent, half.rank, half.money.rank, half.missing) == ("half", None, None, TASKS[1:])
    assert half.money.mean.value == pytest.approx(7.0)
    assert half.money.against_rules.value == pytest.approx(7.0 - 1.0), "on the task that both have"
    assert missing_notes(over_both(both)) == ["half is not ranked: it lacks B-v1. Its figures are over the tasks that it has."]


def test_rules_that_lack_a_task_are_not_compared_with(both):
    lacking = [item for item in both if (item.result.agent.name, item.result.task.id) != (RULES, TASKS[1])]
    table = over_both(lacking)
    assert all(row.money.against_rules is None for row in table.rows)
    assert f"{RULES} lacks tasks, so none is compared with it." in "\n".join(suite_markdown(table))


def test_a_suite_has_orders_at_other_prices_and_a_frontier(both):
    rows = {row.agent: row for row in over_both(both).rows}
    assert [(one.rank, round(one.mean, 9)) for one in rows["spiky"].at_prices] == [(1, 17.0), (1, 16.0), (1, 14.0)]
    assert [rows[agent].frontier for agent in ("spiky", "steady", RULES, "half")] == [True, True, False, None]
