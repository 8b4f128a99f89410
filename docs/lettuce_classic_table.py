"""The table of lettuce-classic.md, released results beside published ones: ``python -m docs.lettuce_classic_table`` makes it.

Published are the tables in the README of lettuce-greenhouse-gym 0.1.3, as its wheel has it (METADATA).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from docs.tables import with_tables
from glbench.evaluation import load_result
from glbench.tasks import get_task

ROOT = Path(__file__).resolve().parent.parent
PAGE = Path(__file__).parent / "lettuce-classic.md"
RESULTS = ROOT / "reports" / "released" / "results"
TASKS = ("LettuceClassic-Delta00-v1", "LettuceClassic-Delta05-v1")


class Row(NamedTuple):
    """A controller: its baseline here, and its published name and returns [EUR m-2] with nominal and with redrawn coefficients."""

    words: str
    baseline: str = ""
    published_name: str = ""
    published: tuple[str, str] = ("", "")


ROWS = (
    Row("a grower's rules", "rule_based_lettuce", "`GrowerHeuristic`", ("-4.35", "")),
    Row("predictive control, nominal, 6 h", "mpc_lettuce", "`NominalMPC`, horizon 12", ("3.62", "2.13 ± 0.02 (3 seeds)")),
    Row("predictive control, three draws, 6 h", "mpc_scenario_lettuce"),
    Row("predictive control, end value, 3 h", "mpc_value_lettuce"),
    Row("SAC, 13 steps of weather", "", "SAC, 192k steps", ("2.89", "2.35 ± 0.03 (10 seeds)")),
    Row("PPO, weather of now", "", "PPO, 1M steps", ("2.36", "")),
)


def score(task: str, baseline: str) -> str:
    """Mean reward and, of several runs, its standard deviation and their number; a dash without a result."""
    file = RESULTS / task / f"{baseline}.json"
    if not file.is_file():
        return "–"
    rewards = np.array([run.metrics["reward"] for run in load_result(file).runs])
    if len(rewards) == 1:
        return minus(f"{rewards[0]:.2f}")
    whole = get_task(task).evaluation.runs
    runs = f"{len(rewards)} of {whole}" if len(rewards) < whole else whole
    return minus(f"{rewards.mean():.2f} ± {rewards.std(ddof=1):.2f} ({runs} runs)")


def minus(number: str) -> str:
    """A number with the sign that tables have."""
    return number.replace("-", "−")


def filled(page: str) -> str:
    """The page with the table of what is released now."""
    lines = [
        "| controller | baseline | nominal coefficients | redrawn within 5 % | published as | nominal | redrawn |",
        "|---|---|---:|---:|---|---:|---:|",
    ]
    for row in ROWS:
        ours = [score(task, row.baseline) if row.baseline else "–" for task in TASKS]
        theirs = [minus(one) or "–" for one in row.published]
        name = f"`{row.baseline}`" if row.baseline else "–"
        lines.append(f"| {' | '.join((row.words, name, *ours, row.published_name or '–', *theirs))} |")
    return with_tables(page, {"returns": "\n".join(lines)})


def main() -> int:
    """Write the page."""
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
