"""Scores over suites are shown no finer than they mean."""

from __future__ import annotations

import pytest

from glbench.leaderboard.statistics import Interval
from glbench.leaderboard.tables import chance_text, format_interval, probability_text


def test_an_interval_narrower_than_seasons_and_trainings_move_a_score_is_not_shown():
    assert format_interval(Interval(value=0.99996, low=0.9999, high=1.0001), is_range=False) == "1.000"
    assert format_interval(Interval(value=0.9120, low=0.9001, high=0.9240), is_range=False) == "0.912 [0.90 to 0.92]"


def test_trainings_show_their_range_however_narrow():
    assert format_interval(Interval(value=0.982, low=0.981, high=0.983), is_range=True) == "0.982 [0.981 ↔ 0.983]"


@pytest.mark.parametrize(("value", "text"), [(1.0, ">0.99"), (0.0, "<0.01"), (0.5, "0.50"), (0.995, ">0.99")])
def test_no_probability_is_certain(value, text):
    assert chance_text(value) == text


def test_a_probability_has_an_interval_where_it_has_width():
    assert probability_text(Interval(value=1.0, low=1.0, high=1.0)) == ">0.99"
    assert probability_text(Interval(value=0.6, low=0.55, high=0.68)) == "0.60 [0.55, 0.68]"
