"""The table of lettuce-classic.md, released results beside published ones: ``python -m docs.lettuce_classic_table`` makes it.

Published are the tables in the README of lettuce-greenhouse-gym 0.1.3, as its wheel has it (METADATA).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from docs.tables import with_tables
from glbench.evaluation import Result, load_result
from glbench.tasks import list_tasks

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
    Row("imitation of three draws, 6 h", "imitation_lettuce"),
    Row("SAC, 13 steps of weather", "sac_lettuce", "SAC, 192k steps", ("2.89", "2.35 ± 0.03 (10 seeds)")),
    Row("TD3, 13 steps of weather", "td3_lettuce"),
    Row("PPO, 13 steps of weather", "ppo_lettuce"),
    Row("PPO, weather of now", "", "PPO, 1M steps", ("2.36", "")),
)


def results_of(task: str, baseline: str) -> list[Result]:
    """Released results of a baseline and of its other trainings."""
    files = [RESULTS / task / f"{baseline}.json", *sorted((RESULTS / task).glob(f"{baseline}_seed?.json"))]
    return [load_result(file) for file in files if file.is_file()]


def score(task: str, baseline: str) -> str:
    """Mean reward and, of several runs, their standard deviation within a training and their number; a dash without a result."""
    results = results_of(task, baseline)
    if not results:
        return "–"
    rewards = np.array([[run.metrics["reward"] for run in result.runs] for result in results])
    trainings, count = rewards.shape
    if count == 1:
        return minus(f"{rewards.mean():.2f}")
    whole = next(one.evaluation.runs for one in list_tasks() if one.short_id == task)
    runs = f"{count} of {whole}" if count < whole else whole
    runs = f"{trainings} trainings, {runs}" if trainings > 1 else runs
    return minus(f"{rewards.mean():.2f} ± {rewards.std(axis=1, ddof=1).mean():.2f} ({runs} runs)")


def decision(baseline: str) -> str:
    """Mean time of a decision for one run [ms], with redrawn coefficients."""
    times = [result.evaluation.decision_milliseconds for result in results_of(TASKS[1], baseline)]
    return (f"{np.mean(times):.0f}" if np.mean(times) >= 10.0 else f"{np.mean(times):.2g}") if times else "–"


def minus(number: str) -> str:
    """A number with the sign that tables have."""
    return number.replace("-", "−")


def filled(page: str) -> str:
    """The page with the table of what is released now."""
    lines = [
        "| controller | baseline | nominal coefficients | redrawn within 5 % | decision, ms | published as | nominal | redrawn |",
        "|---|---|---:|---:|---:|---|---:|---:|",
    ]
    for row in ROWS:
        ours = [*(score(task, row.baseline) for task in TASKS), decision(row.baseline)] if row.baseline else ["–"] * 3
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
