"""Two agents on one task, pair by pair."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.errors import ResultError
from glbench.leaderboard import pairs
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.statistics import corrected
from tests.leaderboard.synthetic import digest_of, make_entry

REWARDS = list(np.random.default_rng(1).normal(3000.0, 20.0, 30))


def test_differences_are_means_of_pairs_with_their_interval():
    pair = compare_entries(make_entry("a", [r + 5.0 for r in REWARDS]), make_entry("b", REWARDS))
    reward = pair.metrics["reward"]
    assert reward.difference.value == pytest.approx(5.0)
    assert reward.first - reward.second == pytest.approx(5.0)
    assert pair.metrics["epi"].difference.value == pytest.approx(0.005)


def test_what_costs_more_takes_from_the_money():
    pair = compare_entries(make_entry("a", [r + 1000.0 for r in REWARDS]), make_entry("b", REWARDS))
    assert pair.money["revenue"] == pytest.approx(1.0)
    assert pair.money["cost_heat"] == pytest.approx(-1.0)


def test_only_common_seeds_count():
    pair = compare_entries(make_entry("a", REWARDS), make_entry("b", REWARDS[5:15], first_seed=671))
    assert pair.runs == 10
    assert pair.metrics["reward"].difference.value == 0.0


def test_results_of_different_tasks_or_seeds_are_not_compared():
    with pytest.raises(ResultError, match="one and the same task"):
        compare_entries(make_entry("a", REWARDS), make_entry("b", REWARDS, task_digest=digest_of("other")))
    with pytest.raises(ResultError, match="no seed in common"):
        compare_entries(make_entry("a", REWARDS), make_entry("b", REWARDS, first_seed=1))


def test_p_values_of_several_tasks_are_corrected_together():
    noise = np.random.default_rng(2).normal(0.8, 1.0, 30)
    pair = compare_entries(make_entry("a", list(np.array(REWARDS) + noise)), make_entry("b", REWARDS))
    other = compare_entries(make_entry("a", REWARDS), make_entry("b", REWARDS))
    assert (pair.p_value < 0.05, other.p_value) == (True, 1.0)
    assert corrected([pair.p_value, other.p_value]) == pytest.approx([2 * pair.p_value, 1.0])


def test_agents_are_compared_by_the_metric_that_ranks(monkeypatch):
    first, second = make_entry("a", [r + 5.0 for r in REWARDS]), make_entry("b", REWARDS)
    monkeypatch.setattr(pairs, "metric_of", lambda *_: "epi")
    pair = compare_entries(first, second)
    assert pair.ranks_by == "epi"
    assert pair.headline == pytest.approx(0.005)
