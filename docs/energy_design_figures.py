"""Tables of docs/energy-design.md: ``python -m docs.energy_design_figures [--work runs/design] [--only-page]``.

Evaluates the energy rules, copies of them that do without one decision each, blind recordings, and a few other agents on seasons made of
the training years, drawn with keys that no split has, so that nothing here has seen a test. A linear programme with foresight says what
the equipment could have earned. Writes docs/measurements/energy-design.json and the tables between the markers of the page. Evaluations
that are there already in the work folder are not done again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from docs.benchmark_design_figures import (
    DOCS,
    DRAWS,
    MADE,
    MONEY,
    MY_AGENT,
    NOTHING,
    PI,
    RECORDED,
    ROOT,
    YEARS,
    Job,
    Scores,
    Tables,
    design,
    evaluated,
    grid,
    percent,
    plain,
    recorded,
    score_table,
    scores_of,
    signed,
    write,
)
from glbench.agents.energy_rules import EnergyRulesAgent, EnergyRuleSettings
from glbench.agents.tuned_rules import RulePage, read_rule_page, settings_text
from glbench.bounds.energy_costs import Costs, costs_of_result
from glbench.env import Simulation
from glbench.resources import write_atomically
from glbench.tasks import task_card

PAGE, FIGURES = DOCS / "energy-design.md", DOCS / "measurements" / "energy-design.json"
PAGES = ROOT / "baselines" / "rule_based_energy" / "rules"
RULES = "energy_rules"
"""The baseline ``rule_based_energy``, as a folder with the one page of a family: a folder cannot have a baseline's name."""

RUNS: Mapping[str, int] = {"WinterLED": 30, "SpringEnergy": 30, "FullSeason": 10, "FullSeasonEnergy": 10}
"""Scenarios of each family; fewer where a season has 300 days."""
ENERGY = ("SpringEnergy", "FullSeasonEnergy")
"""Families with engine, boiler and buffer."""
LIT = ("WinterLED", "FullSeason", "FullSeasonEnergy")
"""Families in which lamps pay."""

NO_ENGINE = {"engine_price": 0.4, "engine_full": 0.4, "engine_cold": 0.0, "engine_stay": 0.0}
NO_STORE = {"buffer_full": 5.0, "buffer_low": 5.0}
LAMPS: Mapping[str, Mapping[str, float]] = {
    "never_lights": {"lamps_fruit": 0.0},
    "lights_at_any_price": {"lamps_fruit": 0.5},
    "lights_by_the_clock": {"lamps_fruit": 0.5, "lamps_from": 0.0, "lamps_until": 12.0},
}
MACHINES: Mapping[str, Mapping[str, float]] = {
    "never_runs_the_engine": NO_ENGINE,
    "runs_it_at_any_price": {"engine_price": -0.05, "engine_full": 0.0, "engine_cold": 0.0, "engine_wait": 0.0},
    "never_stores": NO_STORE,
    "boiler_alone": {**NO_ENGINE, **NO_STORE},
}
VARIANTS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    family: {**(LAMPS if family in LIT else {}), **(MACHINES if family in ENERGY else {})} for family in RUNS
}
"""Numbers of the rules that each copy of them changes; all others stay those of the family's page."""
SIMPLEST = {family: "boiler_alone" if family in ENERGY else "never_lights" for family in RUNS}
"""The simplest sensible agent, from whose score a lead is counted."""
WHOLE = ("FullSeason", "FullSeasonEnergy")
"""Families that begin in January: in a frost the simulation of a house that nobody heats can fail."""
EXAMPLE = str(ROOT / "submissions" / "energy_agent.py")
PLAYING = ("rule_based_tuned", MY_AGENT, PI)
"""Agents that know no engine; they play where there is none."""
RECORDING = f"recording_of_{RULES}"

KEPT = (
    *MONEY,
    "electricity",
    "engine_hours",
    "electricity_sold",
    "electricity_bought",
    "gas",
    "co2_bought",
    "fruit_picked",
    "fruit_gained",
)
"""Metrics that are kept of each run, where its task has them."""
FLOWS = {
    "engine_hours": "engine [h]",
    "gas": "gas [kWh]",
    "electricity_sold": "power sold [kWh]",
    "electricity_bought": "power bought [kWh]",
    "co2_bought": "CO2 bought [kg]",
}
GROWING, GROWN_RUNS = ("FullSeason", "FullSeasonEnergy"), 4
"""Families whose crop grows from planting on, and in how many seasons it is looked at."""
DISPATCHED, DISPATCHED_RUNS = "SpringEnergy", 4
"""The family whose recorded runs a linear programme plans again, and how many of them."""

_CARD = """title = "Energy rules, {name}"
controller = "rule_based_energy"
settings = "page.yml"
description = "The rules of {page} with {changed}."
made = "python -m docs.energy_design_figures"
sources = []
"""


def make_agents(work: Path) -> None:
    """Write the folders of the rules and of their copies, for each family: a card and one page, which then serves any task."""
    for family, variants in VARIANTS.items():
        source = PAGES / f"{family.lower()}.yml"
        page = read_rule_page(source, EnergyRuleSettings)
        for name, changed in {RULES: {}, **variants}.items():
            folder = work / MADE / family / name
            folder.mkdir(parents=True, exist_ok=True)
            numbers = type(page.numbers)(**{**page.numbers.model_dump(), **changed})
            write_atomically(folder / "page.yml", settings_text(RulePage(page.scope, numbers)))
            words = ", ".join(f"{key} = {value:g}" for key, value in changed.items()) or "nothing changed"
            write_atomically(folder / "card.toml", _CARD.format(name=name, page=source.name, changed=words))


def jobs() -> list[Job]:
    """Everything that is evaluated."""
    found = []
    for family, runs in RUNS.items():
        task, season = design(family, DRAWS, runs=runs), design(family, RECORDED, runs=runs)
        others = (EXAMPLE, *(() if family in ENERGY else PLAYING), *(() if family in WHOLE else (NOTHING,)))
        made = (f"{family}/{name}" for name in (RULES, *VARIANTS[family]))
        found += [Job(family, task, agent) for agent in (*made, *others)]
        found.append(Job(family, task, f"{family}/{RULES}", season))
    return found


def measure(work: Path, processes: int) -> dict[str, Any]:
    """Metrics of each run by family and agent, and costs of energy in runs that were dispatched again [EUR m-2]."""
    make_agents(work)
    asked = jobs()
    found = evaluated(asked, work, processes, KEPT)
    played = next(job for job in asked if (job.label, job.name) == (DISPATCHED, RULES))
    seeds = list(played.task.evaluation.seeds)[:DISPATCHED_RUNS]
    costs = [asdict(one) for _, one in costs_of_result(played.file(work), seeds)]
    growth = {family: grown(family) for family in GROWING}
    return {"runs": dict(RUNS), "years": YEARS, "evaluations": found, "dispatch": costs, "growth": growth}


def grown(family: str) -> list[dict[str, float]]:
    """The crop that the rules grow in ``family``, month by month: mean over a few seasons."""
    task = design(family, DRAWS, runs=GROWN_RUNS)
    simulation = Simulation(task, GROWN_RUNS)
    agent = EnergyRulesAgent([read_rule_page(PAGES / f"{family.lower()}.yml", EnergyRuleSettings).numbers] * GROWN_RUNS)
    seen, card = simulation.reset(list(task.evaluation.seeds)), task_card(task)
    agent.reset(card, GROWN_RUNS)
    model, days, rows, picked = task.model_value, round(86_400 / task.step_seconds), [], 0.0

    def mass(*states: str) -> float:
        return float(sum(simulation.x[:, model.state_index(name)].mean() for name in states)) * 1e-6

    sla = float(task.parameters_by_name()["sla"])
    for step in range(task.steps + 1):
        if step % (30 * days) == 0:
            row = {"day": step / days, "lai": mass("cLeaf") * 1e6 * sla, "plants": mass("cLeaf", "cStem")}
            rows.append(row | {"fruit": mass("cFruit"), "picked": picked})
        if step < task.steps:
            result = simulation.step(agent.act(seen))
            seen, picked = result.observations, picked + float(result.quantities["fruit_picked"].mean())
    return rows


# What the figures say.


def measured(figures: Mapping[str, Any], families: Iterable[str] = RUNS) -> list[str]:
    """Those of the families that were measured."""
    return [family for family in families if family in figures["runs"]]


def paired(figures: Mapping[str, Any], family: str, agent: str, other: str = RULES) -> tuple[float, float]:
    """Mean score of an agent less that of another in the same runs, and the standard error of the mean."""
    scores = scores_of(figures, family, [agent, other])
    difference = scores[agent] - scores[other]
    return float(difference.mean()), float(difference.std(ddof=1) / len(difference) ** 0.5)


def blind(figures: Mapping[str, Any], family: str) -> tuple[Scores, Scores, dict[str, float]]:
    """Scores of the rules and of their recording, and what that loses of the lead over the simplest sensible agent."""
    own, recording, reference = scores_of(figures, family, [RULES, RECORDING, SIMPLEST[family]]).values()
    return own, recording, recorded(own, recording, reference)


def dispatched(figures: Mapping[str, Any]) -> list[Costs]:
    """Costs of energy and CO2 of the runs that were planned again."""
    return [Costs(**one) for one in figures["dispatch"]]


def possible(found: Iterable[Costs], name: str) -> list[float]:
    """One cost of the runs in which it is possible: without a buffer not every demand can be met."""
    return [value for value in (getattr(one, name) for one in found) if value is not None]


# The page.


def family_table(figures: Mapping[str, Any]) -> str:
    """Score of all agents on each family, and of what profit and violations it is made."""
    return score_table({family: figures["evaluations"][family] for family in measured(figures)})


def decision_table(figures: Mapping[str, Any]) -> str:
    """What each copy of the rules earns more or less than they do."""

    def cell(family: str, name: str) -> str:
        if name not in VARIANTS[family]:
            return "–"
        difference, error = paired(figures, family, name)
        return f"{signed(difference)} ± {plain(error)}"

    names = dict.fromkeys(name for family in measured(figures) for name in VARIANTS[family])
    rows = ([f"`{name}`", *(cell(family, name) for family in measured(figures))] for name in names)
    head = (f"{family}, {figures['runs'][family]} seasons" for family in measured(figures))
    return grid(["Copy of the rules", *head], rows)


def flow_table(figures: Mapping[str, Any]) -> str:
    """What the rules and their copies do with engine, gas, power and CO2."""
    rows = []
    for family in measured(figures, ENERGY):
        for name in (RULES, *VARIANTS[family]):
            found = figures["evaluations"][family][name]
            rows.append([family, f"`{name}`", *(f"{np.mean(found[key]):.1f}" for key in FLOWS)])
    return grid(["Family", "Agent", *FLOWS.values()], rows)


def recording_table(figures: Mapping[str, Any]) -> str:
    """What a blind recording of the rules earns."""
    rows = []
    for family in measured(figures):
        own, recording, told = blind(figures, family)
        multiple = "no lead" if np.isnan(told["multiple"]) else f"{told['multiple']:.1f}"
        found = (own.mean(), told["lead"], recording.mean(), told["lost"])
        rows.append([family, f"`{SIMPLEST[family]}`", *map(plain, found), multiple, percent(told["below"])])
    head = ["Family", "Simplest sensible agent", "The rules", "Their lead over it", "Their recording", "Lost"]
    return grid([*head, "Lost / lead", "Seasons below the simplest"], rows)


_COSTS = {
    "run": "As recorded",
    "least": "Least cost",
    "blind": "Planned at mean prices",
    "without_buffer": "Least cost without the buffer",
    "without_engine": "Least cost without the engine",
    "boiler_alone": "Least cost with the boiler alone",
}
_EARNED = {
    "buffer_earns": "**The buffer earns at best**",
    "engine_earns": "**The engine earns at best**",
    "looking_earns": "**Knowing how prices vary earns at best**",
    "left": "**Missed by the rules**",
}


def dispatch_table(figures: Mapping[str, Any]) -> str:
    """What the linear programme with foresight says."""
    found = dispatched(figures)
    rows = []
    for name, words in {**_COSTS, **_EARNED}.items():
        values = possible(found, name)
        among = "" if len(values) == len(found) else f", possible in {len(values)}"
        rows.append([words + among, plain(float(np.mean(values))), f"{plain(min(values))} to {plain(max(values))}"])
    return grid([f"{DISPATCHED}, {len(found)} seasons", "EUR/m²", "from run to run"], rows)


def growth_table(figures: Mapping[str, Any]) -> str:
    """How the crop grows from planting on."""
    head = [
        "Family",
        "Day",
        "Leaf area index",
        "Leaves and stems [kg/m² dry]",
        "Fruit on the plants [kg/m² dry]",
        "Fruit picked [kg/m² fresh]",
    ]
    rows = [
        [family, f"{row['day']:.0f}", *(f"{row[key]:.2f}" for key in ("lai", "plants", "fruit")), f"{row['picked']:.1f}"]
        for family, found in figures["growth"].items()
        for row in found
    ]
    return grid(head, rows)


TABLES: Tables = {
    "families": family_table,
    "decisions": decision_table,
    "flows": flow_table,
    "recordings": recording_table,
    "dispatch": dispatch_table,
    "growth": growth_table,
}


if __name__ == "__main__":
    write(__doc__, FIGURES, PAGE, TABLES, measure)
