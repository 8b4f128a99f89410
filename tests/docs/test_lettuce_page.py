"""docs/lettuce.md: its tables, and what its sentences claim."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs import harvest_figures, lettuce_figures
from docs.benchmark_design_figures import filled, read
from docs.greenhouse_design_figures import jobs, scores


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return read(lettuce_figures.FIGURES)


def test_the_page_holds_the_measurements(figures: dict[str, Any]) -> None:
    page = lettuce_figures.PAGE.read_text(encoding="utf-8")
    assert filled(page, figures, lettuce_figures.TABLES) == page


def test_everything_was_evaluated_in_as_many_seasons_of_each_year(figures: dict[str, Any]) -> None:
    there = {(year, agent) for year, agents in figures["evaluations"].items() for agent in agents}
    assert {(job.label, job.name) for job in jobs("Lettuce-v2", lettuce_figures.AGENTS, lettuce_figures.ACTING)} == there
    for agents in figures["evaluations"].values():
        assert {len(values) for kept in agents.values() for values in kept.values()} == {figures["runs"]}


def test_recordings_lose_more_than_the_lead(figures: dict[str, Any]) -> None:
    zero = scores(figures, lettuce_figures.ZERO).mean()
    for agent in (Path(agent).stem for agent in lettuce_figures.ACTING):
        assert scores(figures, f"recording_of_{agent}").mean() < zero


def test_what_the_page_says_of_orders_and_numbers(figures: dict[str, Any]) -> None:
    names = [Path(agent).stem for agent in lettuce_figures.AGENTS]
    by_year = {name: scores(figures, name).mean(axis=1) for name in names}
    pairs = {(a, b) for a in names for b in names if a < b and len(set(np.sign(by_year[a] - by_year[b]))) > 1}
    assert {name for pair in pairs for name in pair} == {"constant_setpoints", "rule_based_fair", "rule_based_tuned"}
    order = sorted(names, key=lambda name: -by_year[name].mean())
    assert set(order[:3]) == {lettuce_figures.MEMORY, lettuce_figures.POLICY, lettuce_figures.RULES}
    assert order[3] == "outdoor"


def test_the_page_holds_what_the_day_of_harvest_is_worth() -> None:
    figures, page = read(harvest_figures.FIGURES), harvest_figures.PAGE.read_text(encoding="utf-8")
    assert filled(page, figures, {"harvest": harvest_figures.table}) == page
    assert {len(one) for split in ("training", "validation") for one in figures[split]["score"]} == {figures["runs"]}


def test_rules_that_look_earn_more_than_the_best_blind_ones_in_all_validation_seasons() -> None:
    figures, page = read(harvest_figures.RULE_FIGURES), harvest_figures.PAGE.read_text(encoding="utf-8")
    assert filled(page, figures, {"harvest_rules": harvest_figures.rules_table}) == page
    assert {len(values) for values in figures["values"].values()} == {120}
    places, signs = harvest_figures.chosen(read(harvest_figures.FIGURES)), read(harvest_figures.FIGURES)["signs"]
    assert [signs[places[sign]][1] for sign in ("reference", "day", "sample")] == [40, 46, 360], "the numbers of RULES"
    share, gap = harvest_figures.what_looking_is_worth(figures)
    assert gap.low > 0.0
    assert share.high is not None
    assert share.high < 0.5


def test_who_looks_at_no_plant_keeps_little_of_what_the_day_of_harvest_is_worth() -> None:
    figures = read(harvest_figures.FIGURES)
    shares = harvest_figures.shares(figures)
    assert max(shares[sign] for sign in harvest_figures.BLIND) < 0.25
    assert shares["sample"] > 0.5
    days = harvest_figures.best_days(figures)
    assert [days.min(), days.max()] == [min(harvest_figures.SIGNS["day"]), max(harvest_figures.SIGNS["day"])] == [27.0, 54.0]
    assert np.count_nonzero((days <= 33.0) | (days >= 46.0)) == 19
    assert figures["runs"] == 24
