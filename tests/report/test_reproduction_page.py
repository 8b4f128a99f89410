"""docs/reproduction.md: its tables and figures are those of the released results."""

from __future__ import annotations

import re
from pathlib import Path

from docs import reproduction_figures as script

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def test_tables_and_figures_are_those_of_the_results() -> None:
    points = script.collect(ROOT / "reports" / "released" / "results")
    page = (DOCS / "reproduction.md").read_text(encoding="utf-8")
    assert script.filled(page, points) == page
    for name, figure in script.figures(points).items():
        assert (DOCS / "images" / name).read_text(encoding="utf-8") == figure
    for agent in set(script.AGENTS) - {"recording"}:  # recorded at one level, and perhaps not played back at all of them
        assert sorted({level for name, level, _ in points if name == agent}) == list(script.LEVELS)


def test_trainings_are_set_side_by_side() -> None:
    values = {"ppo": (3800.0, 3.5), "ppo_seed1": (3751.2, 3.25), "sac": (3700.0, 1.0)}
    points = {
        (agent, 10, metric): script.Point(value, value, value)
        for agent, pair in values.items()
        for metric, value in zip(("reward", "epi"), pair, strict=True)
    }
    rows = [re.split(r"\s*\|\s*", row.strip("| ")) for row in script.trainings_table(points).splitlines()[2:]]
    assert rows == [["`ppo`, ± 10 %", "reward", "3,800", "3,751", "–", "49"], ["`ppo`, ± 10 %", "EPI, EUR/m²", "3.50", "3.25", "–", "0.25"]]
