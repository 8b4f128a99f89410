"""Fills the tables of expected learning curves in training.md from the shipped trainings: ``python -m docs.training_curve_table``."""

from __future__ import annotations

import csv
import json
from pathlib import Path

from docs.tables import with_tables

ROOT = Path(__file__).resolve().parent.parent
PAGE = Path(__file__).parent / "training.md"
CURVES = {
    "training_curve_greenhouse": ("GreenhouseReal-v1", "training/greenhousereal.csv", "ppo_greenhouse"),
    "training_curve": ("Spring-v1", "training/spring.csv", "ppo_fast"),
}
"""By the name of a table: task, learning curve and recipe of its trainings."""
EVERY = 2
"""Of the evaluations after the first two, every other one is shown."""


def table(task: str, curve: str, recipe: str) -> str:
    """Mean reward of every shown evaluation on the validation split, and of the released result on the test split, one row a training."""
    rows, steps = [], list[int]()
    seeds = [recipe, *(f"{recipe}_seed{seed}" for seed in range(1, 5))]
    for name in (one for one in seeds if (ROOT / "baselines" / one / curve).is_file()):
        with (ROOT / "baselines" / name / curve).open(encoding="utf-8") as file:
            points = list(csv.DictReader(file))
        shown = [*points[:2], *points[2::EVERY]]
        steps = [int(point["steps"]) for point in shown]
        released = json.loads((ROOT / "reports/released/results" / task / f"{name}.json").read_text(encoding="utf-8"))
        cells = [f"{float(point['reward']):.2f}" for point in shown]
        rows.append(f"| `{name}` | {' | '.join(cells)} | {released['summary']['mean']['reward']:.2f} |")
    head = [f"| steps | {' | '.join(f'{step:,}' for step in steps)} | test split |", "|---" + "|---:" * (len(steps) + 1) + "|"]
    return "\n".join([*head, *rows])


def filled(page: str) -> str:
    """The page with the tables."""
    return with_tables(page, {name: table(*which) for name, which in CURVES.items()})


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
