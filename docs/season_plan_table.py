"""Measurements behind docs/adr/0019: ``python -m docs.season_plan_table`` (about 20 minutes of one core).

Plans training seasons of glbench/Spring-v1 with and without parts of the method, beginning with the example ``my_agent``, and writes what
the plans earn after some iterations, and the seconds of an iteration, into docs/measurements/season-plans.json.
"""

from __future__ import annotations

import json
import logging
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from glbench.bounds import agent_controls
from glbench.control import Iteration, Scenario, plan_season, season
from glbench.evaluation import protect
from glbench.resources import data_folder, write_atomically
from glbench.tasks import get_task

FILE = Path(__file__).resolve().parent / "measurements" / "season-plans.json"
TASK, SEEDS = "Spring-v1", (3, 11, 27)
ITERATIONS = 30
SHOWN = (10, 20, 30)
log = logging.getLogger("plans")


def _as_it_is(search: Any, stage: Any, lines: Any, reach: Any, move: Any) -> Any:
    return move


VARIANTS: dict[str, dict[str, Any]] = {
    "as shipped": {},
    "without second-order correction": {"_Search._corrected": _as_it_is},
    "trust regions that shrink faster": {"_SHRINK": 0.6},
    "trust regions that start smaller": {"_FIRST_RADIUS": 0.03},
}


def main() -> None:
    """Plan, write, print."""
    task = get_task(TASK)
    starts = agent_controls(task, protect(data_folder("submissions") / "my_agent.py", "auto"), SEEDS)
    found: dict[str, Any] = {"task": task.id, "split": task.split, "seeds": list(SEEDS), "variants": {}}
    for name, changes in VARIANTS.items():
        rewards: list[list[float]] = []
        seconds: list[float] = []
        with changed(changes):
            for seed, controls in zip(SEEDS, starts, strict=True):
                told: list[float] = []
                began = time.process_time()
                plan_season(Scenario.of(task, seed), controls, iterations=ITERATIONS, watch=noting(told))
                seconds.append((time.process_time() - began) / ITERATIONS)
                rewards.append([round(told[number - 1], 3) for number in SHOWN])
        means = [round(statistics.fmean(column), 3) for column in zip(*rewards, strict=True)]
        found["variants"][name] = {
            "iterations": list(SHOWN),
            "rewards": rewards,
            "mean": means,
            "cpu_seconds_an_iteration": round(statistics.median(seconds), 2),
        }
        log.info("%-34s %s  %s s an iteration", name, means, found["variants"][name]["cpu_seconds_an_iteration"])
    write_atomically(FILE, json.dumps(found, indent=2) + "\n")


def noting(told: list[float]) -> Callable[[Iteration], None]:
    """Writes down the reward of each iteration."""
    return lambda iteration: told.append(iteration.reward)


@contextmanager
def changed(changes: dict[str, Any]) -> Iterator[None]:
    """The planner with other parts."""
    patches = [mock.patch(f"{season.__name__}.{name}", value) for name, value in changes.items()]
    for patch in patches:
        patch.start()
    try:
        yield
    finally:
        mock.patch.stopall()


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    main()
