"""What fresh draws say of sensible agents, and of one that carries the published plans: measured, for statistics.md.

``python -m docs.fresh_draws_table FOLDER`` evaluates each on Spring-v1 with the published and with fresh draws below FOLDER, continues what
was interrupted, and writes measurements/fresh-draws.json and the table. The salts are new each time, and stand in the file.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from docs.tables import with_tables
from glbench.agents.plans import PlanBook, read_book
from glbench.env import Simulation
from glbench.evaluation import Result, protect
from glbench.evaluation.fresh_draws import add_fresh_draws
from glbench.evaluation.jobs import Job, Options
from glbench.leaderboard.fresh_draws import fresh_score
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task

TASK: Final = "Spring-v1"
AGENTS: Final = (("my_agent", None), ("ppo_fast", None), ("ppo_memory", None), ("mpc", 10), ("carries_plans", None))
"""Agents, and the number of runs where it is not all: predictive control takes 8 ms a decision."""
FILE = Path(__file__).parent / "measurements" / "fresh-draws.json"
PAGE = Path(__file__).parent / "statistics.md"
CARRIER: Final = '''\
"""Plays the published plan of the run that it is in, which it finds by the first observation; elsewhere it is the example my_agent."""

from pathlib import Path

import numpy as np

import sensible


class Carrier:
    def reset(self, task, n_runs):
        carried = np.load(Path(__file__).parent / "carried.npz")
        self.first, self.actions, self.step = carried["first"], carried["actions"], 0
        self.sensible = sensible.make_agent(task)
        self.sensible.reset(task, n_runs)

    def act(self, observations):
        if self.step == 0:
            same = (observations[:, None] == self.first).all(axis=-1)
            self.plan = np.where(same.any(axis=1), same.argmax(axis=1), -1)
        actions = np.array(self.sensible.act(observations))
        known = self.plan >= 0
        actions[known] = self.actions[self.plan[known], self.step]
        self.step += 1
        return actions


def make_agent(task):
    return Carrier()
'''


def write_carrier(folder: Path, task: TaskSpec, book: PlanBook) -> Path:
    """A submission in ``folder`` that carries the plans ``book`` of the test of ``task``, with what is observed first in each run."""
    seeds = [seed for seed in task.evaluation.seeds if seed in book.seeds]
    first = Simulation(task.scored, len(seeds)).reset(seeds)
    folder.mkdir(parents=True)
    np.savez_compressed(folder / "carried.npz", first=first, actions=np.array([book.plan(seed) for seed in seeds]))
    (folder / "agent.py").write_text(CARRIER, encoding="utf-8")
    shutil.copyfile(data_folder("submissions") / "my_agent.py", folder / "sensible.py")
    return folder


def evaluated(name: str, runs: int | None, out: Path) -> Result:
    """The result of an agent, with fresh draws."""
    task, ref = get_task(TASK), name
    if name == "my_agent":
        ref = str(data_folder("submissions") / "my_agent.py")
    elif name == "carries_plans":
        ref = str(out / name)
        if not (out / name).exists():
            write_carrier(out / name, task, read_book(data_folder("baselines") / "best_known" / "plans" / f"{TASK}.npz"))
    job = Job(task, ref, protect(ref, "auto"), Options(out, runs))

    def run(part: Job) -> Result:
        evaluation = part.prepare()
        return evaluation.stored or evaluation.run()

    run(job)
    return add_fresh_draws(job, run)


def facts(result: Result) -> dict[str, Any]:
    """What the page says of a result."""
    score, fresh = fresh_score(result), result.fresh_draws
    assert score is not None
    assert fresh is not None
    published = result.summary.mean[fresh.metric]
    values = [run.metrics[fresh.metric] for run in fresh.runs]
    return {"runs": len(values), "salt": fresh.salt, "published": published, **score.model_dump(), "values": values}


def read() -> dict[str, Any]:
    """What was measured."""
    return dict(json.loads(FILE.read_text(encoding="utf-8")))


def filled(page: str, found: dict[str, Any]) -> str:
    """The page with its table."""
    rows = ["| agent | runs | published | fresh | drop | at least | margin | marked |", "|---|---:|---:|---:|---:|---:|---:|---|"]
    for name, one in found.items():
        numbers = " | ".join(f"{one[key]:.2f}" for key in ("published", "mean", "drop", "low", "margin"))
        rows.append(f"| `{name}` | {one['runs']} | {numbers} | {'yes' if one['marked'] else 'no'} |")
    return with_tables(page, {"fresh": "\n".join(rows)})


if __name__ == "__main__":
    measured = {name: facts(evaluated(name, runs, Path(sys.argv[1]))) for name, runs in AGENTS}
    FILE.write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), measured), encoding="utf-8")
