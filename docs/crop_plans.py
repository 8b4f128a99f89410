"""What plans and rules do with a crop of trusses: measured, and the tables of crop.md.

``python -m docs.crop_plans`` measures everything and writes measurements/crop-plans.json (some minutes of one core); with names of parts,
``windows``, ``plans`` or ``humidity``, it measures those alone. Dark hours: training seasons. Humidity: validation seasons.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents import tuned_rules
from glbench.bounds import agent_controls
from glbench.control import Scenario, StageReward, air_of, plan_season
from glbench.env import Simulation
from glbench.evaluation import protect
from glbench.kernel import Kernel
from glbench.resources import data_folder, write_atomically
from glbench.tasks import TaskSpec, get_task, task_card

Floats = NDArray[np.float64]

FILE = Path(__file__).resolve().parent / "measurements" / "crop-plans.json"
WINTER = {"trusses": "WinterTrusses-v1", "published": "WinterLED-v1"}
SPRING = {"trusses": "SpringTrusses-v1", "published": "Spring-v1"}
START, DAYS = "2010-11-22", 30
"""Earliest first day and length of the winter weeks."""
SEASONS, PLANNED = (3, 11, 27), (3,)
"""Seeds of the training split: of the dark windows, and of the plans."""
WINDOW_FROM, WINDOWS = 16.5, (0, 2, 4, 5, 6, 7, 8, 10)
"""Hour of the day at which the lamps go off, and the hours for which they stay off."""
PLAN_WINDOW, ITERATIONS = 6, 12
SET_POINTS = (75, 78, 80, 82, 83, 84, 85, 86, 88)
"""Relative humidity that the rules hold [%]."""
RUNS = 16
HUMID = 84.5
LIMIT = 85.0
OFF = 0.05
"""Share of their power below which lamps are off."""


def winter(crop: str) -> TaskSpec:
    """Thirty days of winter under lamps."""
    return get_task(WINTER[crop]).replace(id=f"docs/Winter{DAYS}-v1", weather={"days": DAYS, "start": START})


@cache
def agents_controls(crop: str, seed: int) -> Floats:
    """What the example ``energy_agent`` sets in a season."""
    return agent_controls(winter(crop), protect(data_folder("submissions") / "energy_agent.py", "none"), [seed])[0]


def start_controls(crop: str, seed: int, hours: int, *, full: bool) -> Floats:
    """The same with the lamps off for ``hours`` from ``WINDOW_FROM`` on, and on otherwise where ``full``."""
    task, controls = winter(crop), agents_controls(crop, seed).copy()
    lamps = task.model_value.control_names.index("uLamp")
    if full:
        controls[:, lamps] = 1.0
    clock = Scenario.of(task, seed).calendar[:-1, 0]
    controls[(clock - WINDOW_FROM) % 24 < hours, lamps] = 0.0
    return controls


def windows() -> dict[str, Any]:
    """Mean profit [EUR m-2] of winter weeks in which the lamps are off for some hours a day and on otherwise."""
    table: dict[str, Any] = {"split": winter("trusses").split, "seasons": list(SEASONS), "hours": list(WINDOWS), "profit": {}}
    for crop in WINTER:
        task = winter(crop)
        kernel, stage = Kernel(task.model_value, task.step_seconds, preset="fast"), StageReward(task)
        profits = np.zeros((len(SEASONS), len(WINDOWS)))
        for row, seed in enumerate(SEASONS):
            scenario = Scenario.of(task, seed)
            for column, hours in enumerate(WINDOWS):
                controls = start_controls(crop, seed, hours, full=True)
                states = kernel.rollout(scenario.x0, controls, scenario.d, scenario.p)
                profits[row, column] = stage(states, controls, scenario.calendar).epi.sum()
        table["profit"][crop] = np.round(profits.mean(axis=0), 2).tolist()
    return table


def plans() -> dict[str, Any]:
    """Hours a day that the lamps are off in plans which begin with ``PLAN_WINDOW`` dark hours, and what the plans earn [EUR m-2]."""
    table: dict[str, Any] = {"split": winter("trusses").split, "seasons": list(PLANNED), "iterations": ITERATIONS, "crops": {}}
    for crop in WINTER:
        task, rows = winter(crop), []
        lamps = task.model_value.control_names.index("uLamp")
        for seed in PLANNED:
            controls = start_controls(crop, seed, PLAN_WINDOW, full=False)
            plan = plan_season(Scenario.of(task, seed), controls, iterations=ITERATIONS)
            hours = [float(24.0 * np.mean(one[:, lamps] < OFF)) for one in (controls, plan.controls)]
            rows.append([*hours, plan.reward, float(plan.values.epi.sum())])
        keys = ("hours_off_at_start", "hours_off", "reward", "profit")
        table["crops"][crop] = dict(zip(keys, np.round(np.mean(rows, axis=0), 2).tolist(), strict=True))
    return table


def humidity() -> dict[str, Any]:
    """Means of seasons under the tuned rules with the humidity that they hold moved."""
    page = data_folder("baselines") / "rule_based_tuned" / "rules" / "spring.yml"
    shipped = tuned_rules.read_rule_page(page, tuned_rules.TunedRuleSettings).numbers
    numbers = []
    for set_point in SET_POINTS:
        above = set_point - LIMIT
        shift = above - shipped.vents_humidity_night
        moved = {name: getattr(shipped, name) + shift for name in ("boiler_humidity_above", "screen_humidity")}
        numbers.append(shipped.model_copy(update={"vents_humidity_day": above, "vents_humidity_night": above, **moved}))
    table: dict[str, Any] = {"runs": RUNS, "set_points": list(SET_POINTS), "crops": {}}
    for crop, name in SPRING.items():
        task = get_task(name).chosen_on
        table["split"] = task.split
        table["crops"][crop] = _under_rules(task, numbers)
    return table


def _under_rules(task: TaskSpec, numbers: list[Any]) -> dict[str, list[float]]:
    card, model, count = task_card(task), task.model_value, RUNS * len(numbers)
    agent = tuned_rules.TunedRulesAgent([one for one in numbers for _ in range(RUNS)])
    agent.reset(card, count)
    simulation, sums = Simulation(task, count, "fast"), {name: np.zeros(count) for name in ("profit", "penalty", "humid", "mould")}
    observations = simulation.reset([task.evaluation.first_seed + run for run in range(RUNS)] * len(numbers))
    for _ in range(task.steps):
        result = simulation.step(agent.act(observations))
        observations = result.observations
        sums["profit"] += result.quantities["epi"]
        sums["penalty"] += result.quantities["penalty"]
        sums["humid"] += 100.0 * (air_of(model, simulation.x).values[:, 2] > HUMID) / task.steps
        if "mould" in model.state_names:
            sums["mould"] += 100.0 * simulation.x[:, model.state_index("mould")] / task.steps
    return {name: np.round(values.reshape(len(numbers), RUNS).mean(axis=1), 2).tolist() for name, values in sums.items()}


def tables(results: Mapping[str, Any]) -> dict[str, str]:
    """The tables in Markdown, by name."""
    dark, planned, humid = results["windows"], results["plans"]["crops"], results["humidity"]
    lines = ["| lamps off [h a day] | profit, crop of trusses [EUR/m2] | profit, published crop [EUR/m2] |", "|---:|---:|---:|"]
    lines += [f"| {hours} | {a:.2f} | {b:.2f} |" for hours, a, b in zip(dark["hours"], *dark["profit"].values(), strict=True)]
    of_plans = ["| plan | lamps off at the start [h a day] | lamps off in the plan [h a day] | profit [EUR/m2] |", "|---|---:|---:|---:|"]
    for crop, words in {"trusses": "crop of trusses", "published": "published crop"}.items():
        row = planned[crop]
        of_plans.append(f"| {words} | {row['hours_off_at_start']:.1f} | {row['hours_off']:.1f} | {row['profit']:.2f} |")
    head = "| humidity held [%] | profit [EUR/m2] | steps above 84.5 % [%] | diseased share [%] | profit, published crop [EUR/m2] |"
    wet = [head, "|---:|---:|---:|---:|---:|"]
    new, old = (humid["crops"][crop] for crop in SPRING)
    for place, set_point in enumerate(humid["set_points"]):
        cells = [f"{new['profit'][place]:.2f}", f"{new['humid'][place]:.0f}", f"{new['mould'][place]:.2f}", f"{old['profit'][place]:.2f}"]
        wet.append(f"| {set_point} | {' | '.join(cells)} |")
    return {"dark-windows": "\n".join(lines), "dark-plans": "\n".join(of_plans), "humidity": "\n".join(wet)}


PARTS = {"windows": windows, "plans": plans, "humidity": humidity}


if __name__ == "__main__":
    found = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    for part in sys.argv[1:] or PARTS:
        found[part] = PARTS[part]()
        write_atomically(FILE, json.dumps({name: found[name] for name in PARTS if name in found}, indent=1) + "\n")
