"""Measure the typical ranges of observed columns that are missing in ``glbench/tasks/typical_ranges.csv``, and add them.

    python baselines/typical_ranges.py

Rule-based agents without privileges run eight training seasons of each task. A range reaches from the smallest 0.5 percentile to
the largest 99.5 percentile, rounded outwards. Columns whose bounds are nearly as narrow, the clock and the controls keep their bounds.
Existing rows stay unchanged, because policies were trained with them.
"""

from __future__ import annotations

import csv
import io
import math
import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glbench.agents import load_agent
from glbench.env import Simulation
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task, task_card

FILE = Path(__file__).resolve().parent.parent / "glbench" / "tasks" / "typical_ranges.csv"
AGENTS = {
    "GreenhouseReal-v1": ("rule_based_fair", "rule_based_tuned", "rule_based_greenhouse"),
    "Spring-v1": ("rule_based_fair", "rule_based_tuned"),
    "Lettuce-v1": ("rule_based_fair", "rule_based_tuned"),
    "SpringEnergy-v1": ("rule_based_energy",),
    "WinterLED-v1": ("rule_based_energy",),
    "FullSeason-v1": ("rule_based_energy",),
    "FullSeasonEnergy-v1": ("rule_based_energy",),
    "Schiphol2010-Delta10-v1": ("rule_based_fair", "rule_based_tuned"),
    "Schiphol2010Code-Delta10-v1": ("rule_based_fair", "rule_based_tuned"),
    "SpringSetpoints-v1": ("grower",),
}
EXACT = {"time", "local_time", "controls", "control_fractions", "switches", "step_counter"}
"""Modules whose columns reach their bounds."""
SEASONS = range(10_000_000_000, 10_000_000_008)
NEARLY = 2.0 / 3.0
"""Columns whose range is at least this share of their bounds keep the bounds."""


def percentiles(task: TaskSpec, agent: str) -> NDArray[np.float64]:
    """The 0.5 and 99.5 percentiles of every column ``(2, columns)`` in the seasons of an agent."""
    card, simulation = task_card(task), Simulation(task, len(SEASONS), "fast")
    player = load_agent(agent).make(card)
    player.reset(card, len(SEASONS))  # type: ignore[call-arg, arg-type]
    rows = [simulation.reset(SEASONS).copy()]
    for _ in range(task.steps):
        rows.append(simulation.step(player.act(rows[-1])).observations.copy())  # type: ignore[union-attr, arg-type]
    return np.percentile(np.concatenate(rows), [0.5, 99.5], axis=0)


def measured() -> dict[tuple[str, str], tuple[float, float]]:
    """Ranges by name and unit."""
    percentile_ends: dict[tuple[str, str], list[float]] = {}
    bounds: dict[tuple[str, str], float] = {}
    for name, agents in AGENTS.items():
        task = get_task(name)
        exact = {q.name for module in task.observation.modules if module in EXACT for q in task.observed_by(module)}
        for agent in agents:
            for column, ends in zip(task.observed(), percentiles(task, agent).T.tolist(), strict=True):
                if column.name not in exact:
                    key = re.sub(r"_in_\d+h$", "", column.name), column.unit
                    percentile_ends[key] = percentile_ends.get(key, []) + ends
                    bounds[key] = min(bounds.get(key, math.inf), column.high - column.low)
    ranges = {key: rounded(min(ends), max(ends)) for key, ends in percentile_ends.items()}
    return {key: ends for key, ends in ranges.items() if ends[1] - ends[0] < NEARLY * bounds[key]}


def rounded(low: float, high: float) -> tuple[float, float]:
    """The range, rounded outwards to a fifth to a fiftieth of its width."""
    step = 10.0 ** math.floor(math.log10((high - low) / 5.0))
    return math.floor(low / step) * step, math.ceil(high / step) * step


def main() -> None:
    """Add the columns that the file lacks."""
    text = FILE.read_text(encoding="utf-8") if FILE.is_file() else "name,unit,low,high\n"
    existing = {(row["name"], row["unit"]) for row in csv.DictReader(io.StringIO(text))}
    new = {key: ends for key, ends in measured().items() if key not in existing}
    lines = [f"{name},{unit},{low:.6g},{high:.6g}\n" for (name, unit), (low, high) in sorted(new.items())]
    write_atomically(FILE, (text + "".join(lines)).encode("utf-8"))
    sys.stdout.write(f"{len(lines)} columns added to {FILE.name}, {len(existing)} kept.\n")


if __name__ == "__main__":
    main()
