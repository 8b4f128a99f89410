"""How well an agent knows where its greenhouse is and what comes: measured, and the tables of control.md.

``python -m docs.estimator_table`` writes measurements/estimator.json and the tables; with ids of tasks it measures those alone.

Validation splits; of a task without splits runs from seed 10000 on. Somebody else's controller, ``rule_based_fair``, works the greenhouse.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.agents import load_agent
from glbench.control import Climatology, Outlook, StateEstimator, air_of
from glbench.env import Simulation, run_weather
from glbench.env.air import AIR
from glbench.kernel import Kernel
from glbench.tasks import get_task, task_card

Floats = NDArray[np.float64]

TASKS = ("Spring-v1", "SpringMismatch-v1", "Lettuce-v1", "Schiphol2010-Delta10-v1")
RUNS, DAYS, SEED = 4, 30, 10000
LEADS = (1, 2, 4, 12, 24, 48, 95)
PAGE = Path(__file__).parent / "control.md"
FILE = Path(__file__).parent / "measurements" / "estimator.json"


def measured(task_id: str, runs: int = RUNS, days: int = DAYS) -> dict[str, Any]:
    """Root mean square errors of the estimates, of a replay of the nominal model and of the readings; and of the outlook by steps ahead."""
    task = get_task(task_id).chosen_on
    card, model = task_card(task), task.model_value
    simulation, agent = Simulation(task, runs, kernel="fast"), load_agent("rule_based_fair").make(card)
    agent.reset(card, runs)
    seeds = [(SEED if task.splits is None else task.evaluation.first_seed) + run for run in range(runs)]
    climatology = Climatology.of(task)
    outlook, estimator, kernel = (Outlook(task, climatology), StateEstimator(task), Kernel(model, task.step_seconds, preset="fast"))
    outlook.reset(runs)
    estimator.reset(runs)
    seen = simulation.reset(seeds)
    weather = np.array([run_weather(task, seed).values for seed in seeds])
    outlook.update(seen)
    estimator.update(seen, outlook.past)
    replay = np.array([task.start_state(row) for row in outlook.past])
    names = [column.name for column in task.observed()]
    readings = [names.index(name) for name in AIR]
    truth, found, open_loop, raw = [], [], [], []
    ahead: dict[str, dict[int, list[Floats]]] = {who: {lead: [] for lead in LEADS} for who in ("outlook", "persistence", "climatology")}
    for k in range(days * task.steps_per_day):
        if k % 3 == 0:
            now, times = outlook.ahead(LEADS[-1] + 1).d, weather[:, k : k + LEADS[-1] + 1]
            usual = mean_weather(outlook, climatology)
            for lead in LEADS:
                ahead["outlook"][lead].append(now[:, lead] - times[:, lead])
                ahead["persistence"][lead].append(now[:, 0] - times[:, lead])
                ahead["climatology"][lead].append(usual[:, lead] - times[:, lead])
        simulation.step(agent.act(seen))
        seen = simulation.observe()
        outlook.update(seen)
        found.append(estimator.update(seen, outlook.past))
        replay = kernel.step(replay, simulation.u, outlook.past, task.parameters())
        open_loop.append(replay)
        truth.append(simulation.x.copy())
        raw.append(seen[:, readings].astype(np.float64))
    true, airs = np.array(truth), [air_of(model, np.array(part)).values for part in (truth, found, open_loop)]
    table: dict[str, Any] = {"runs": runs, "days": days, "first_seed": seeds[0], "split": task.split, "air": {}, "states": {}, "ahead": {}}
    for place, name in enumerate(AIR):
        others = {"estimate": airs[1], "replay": airs[2], "reading": np.array(raw)}
        table["air"][name] = {who: rms(values[..., place] - airs[0][..., place]) for who, values in others.items()}
    for place, name in enumerate(model.state_names):
        size = rms(true[..., place])
        if size > 0.0:
            table["states"][name] = {
                who: rms(np.array(part)[..., place] - true[..., place]) / size for who, part in (("estimate", found), ("replay", open_loop))
            }
    for place, name in enumerate(model.disturbance_names[:7]):
        table["ahead"][name] = {
            who: {f"{lead}": rms(np.array(errors)[..., place]) for lead, errors in by.items()} for who, by in ahead.items()
        }
    return table


def mean_weather(outlook: Outlook, climatology: Climatology) -> Floats:
    """The weather ahead, by the mean days alone."""
    plain = climatology.without_deviations()
    other = Outlook(outlook.task, plain)
    other.__dict__.update({**vars(outlook), "climatology": plain})
    return other.ahead(LEADS[-1] + 1).d


def rms(errors: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(errors**2)))


def estimates(results: Mapping[str, Any]) -> str:
    """A table in Markdown of the errors of the air, and of the states that were not shown."""
    lines = ["| | | estimate | replay | reading |", "|---|---|---:|---:|---:|"]
    for task, table in results.items():
        for name, row in table["air"].items():
            numbers = " | ".join(_number(row[who]) for who in ("estimate", "replay", "reading"))
            lines.append(f"| `{task}` | {name.replace('_', ' ').replace('co2', 'CO2')} [{AIR[name]}] | {numbers} |")
        shares = [f"{100.0 * _hidden(table, who):.2g} %" for who in ("estimate", "replay")]
        lines.append(f"| | states, the middle one [of its size] | {' | '.join(shares)} | |")
    return "\n".join(lines)


def _hidden(table: Mapping[str, Any], who: str) -> float:
    """The median of the relative errors of all states in which a replay errs."""
    return float(np.median([row[who] for row in table["states"].values() if row["replay"] > 0.0]))


def _number(value: float) -> str:
    return f"{value:.2f}" if value >= 0.005 else "0.00"


def outlooks(results: Mapping[str, Any]) -> str:
    """A table in Markdown of the errors of what is expected, by hours ahead."""
    hours = [4, 12, 24, 48, 95]
    lines = ["| | | | " + " | ".join(f"{round(steps / 4)} h" for steps in hours) + " |", "|---|---|---|" + "---:|" * len(hours)]
    for task in ("Spring-v1", "Schiphol2010-Delta10-v1"):
        for name, words in _AHEAD.items():
            for who, errors in results[task]["ahead"][name].items():
                numbers = " | ".join(f"{errors[str(steps)]:.3g}" for steps in hours)
                lines.append(f"| `{task}` | {words} | {who} | {numbers} |")
    return "\n".join(lines)


_AHEAD = {
    "iGlob": "radiation [W m-2]", "tOut": "temperature [degC]", "vpOut": "vapour pressure [Pa]", "wind": "wind [m s-1]",
    "tSky": "temperature of the sky [degC]",
}  # fmt: skip


def filled(page: str, results: Mapping[str, Any]) -> str:
    """The page with the tables."""
    return with_tables(page, {"estimates": estimates(results), "outlook": outlooks(results)})


if __name__ == "__main__":
    found = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    for wanted in sys.argv[1:] or TASKS:
        found[wanted] = measured(wanted)
        ordered = {task: found[task] for task in TASKS if task in found}
        FILE.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
