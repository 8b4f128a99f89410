"""docs/lettuce.md: its tables, and what its sentences claim."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from docs import lettuce_figures
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
