"""How far the compiled kernel is from all states integrated together, on the default task: the table in kernel-compiled.md.

    python -m docs.follower_error --measure    # plays runs of the validation split: three minutes of a core
    python -m docs.follower_error              # the table, from docs/measurements/follower-error.json

Each step begins in the state that LSODA at 1e-9 (benchmarks/audit.py) has reached, with controls, weather and parameters of a recorded run.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import audit
from docs.tables import with_tables
from glbench.evaluation import evaluate
from glbench.kernel import Kernel
from glbench.resources import write_atomically
from glbench.tasks import get_task

PAGE = Path(__file__).with_name("kernel-compiled.md")
FIGURES = PAGE.parent / "measurements" / "follower-error.json"
TASK, SPLIT, RUNS = "glbench/GreenhouseReal-v1", "validation", 2
AGENTS = ("rule_based_greenhouse", "ppo_memory_greenhouse", str(PAGE.parents[1] / "submissions" / "my_agent.py"))
PROMISED = 1e-6  # of a state's typical size, in a step of `reference`


def measure() -> list[dict[str, Any]]:
    """One entry for each run of each agent."""
    task = audit.Task(audit.task_tables(TASK, Path()), SPLIT)
    with tempfile.TemporaryDirectory() as folder:
        for agent in AGENTS:
            evaluate(get_task(TASK).in_split(SPLIT), agent, out=Path(folder), runs=RUNS, episodes="none")
        records = sorted(Path(folder).rglob("*.actions.mcap"))
        assert len(records) == len(AGENTS), records
        return [errors(task, record.name.removesuffix(".actions.mcap"), run) for record in records for run in audit.read_record(record)[2]]


def errors(task: audit.Task, agent: str, run: audit.Run) -> dict[str, Any]:
    """How far single steps and the whole run are off, in shares of typical sizes and in the reward."""
    row, actions, rewards, _ = run
    weather, schedule = task.weather(row["seed"])
    kernel, size, own = Kernel(task.model, float(task.step)), len(task.states), 0.0
    off = np.empty((len(rewards), size))
    start = task.start(row["seed"], weather[0])
    for k, (before, u_before, u, p, after) in enumerate(task.replay(row["seed"], start, weather, schedule, actions, direct=False)):
        off[k] = np.abs(kernel.step(before[:size], u, weather[k], p) - after[:size]) / task.scale
        own += task.quantities(before, after, u_before, u)["reward"]
    place = int(off.max(axis=0).argmax())
    return {
        "agent": agent,
        "seed": row["seed"],
        "above": float((off > PROMISED).any(axis=1).mean()),
        "largest": float(off.max()),
        "state": task.states[place],
        "step": int(off[:, place].argmax()),
        "score": abs(own - float(rewards.sum())),
    }


def filled(page: str) -> str:
    """The page with the table."""
    lines = [
        "| agent | seed | steps off by more than 1e-6 | largest error | of the state | score, EUR/m² |",
        "|---|---:|---:|---:|---|---:|",
    ]
    for one in json.loads(FIGURES.read_text(encoding="utf-8")):
        numbers = f"{100.0 * one['above']:.0f} % | {one['largest']:.1e} | `{one['state']}` | {one['score']:.1e}".replace("e-0", "e-")
        lines.append(f"| `{one['agent']}` | {one['seed']} | {numbers} |")
    return with_tables(page, {"follower_error": "\n".join(lines)})


if __name__ == "__main__":
    if "--measure" in sys.argv[1:]:
        write_atomically(FIGURES, json.dumps(measure(), indent=1) + "\n")
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8")))
