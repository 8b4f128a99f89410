"""Tables of docs/greenhouse-design.md: ``python -m docs.greenhouse_design_figures [--work runs/design] [--only-page]``.

Evaluates agents of all kinds but predictive control, and blind recordings of some, on seasons of GreenhouseReal-v1 made of the training
years, one year at a time, drawn with salts that no split has, so that nothing here has seen a test. Writes
docs/measurements/greenhouse-design.json and the tables between the markers of the page. Evaluations that are there already in the work
folder are not done again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from docs.benchmark_design_figures import (
    CONSTANT,
    DOCS,
    DRAWS,
    MONEY,
    MY_AGENT,
    NOTHING,
    PI,
    RECORDED,
    YEARS,
    Job,
    Scores,
    Tables,
    design,
    detectable,
    evaluated,
    grid,
    percent,
    plain,
    recorded,
    signed,
    spread,
    stability,
    write,
)

PAGE, FIGURES = DOCS / "greenhouse-design.md", DOCS / "measurements" / "greenhouse-design.json"
FAMILY, RUNS = "GreenhouseReal", 40
"""The task, and its seasons of each year."""
UNLIT = "rule_based_unlit"
"""The controller whose score a lead is counted from."""
RULES, POLICY, MEMORY = "rule_based_greenhouse", "ppo_greenhouse", "ppo_memory_greenhouse"
AGENTS = (MEMORY, POLICY, RULES, "rule_based_tuned", "outdoor", MY_AGENT, PI, CONSTANT, UNLIT, "rule_based", "rule_based_fair", NOTHING)
ACTING = (MEMORY, POLICY, "outdoor", MY_AGENT)
"""Agents that a recording replays."""
SENSIBLE = (MEMORY, POLICY, RULES, "rule_based_tuned", "outdoor", Path(MY_AGENT).stem, UNLIT)
"""Agents within a few euros of each other: any task tells the others from these."""


def jobs(family: str = FAMILY, agents: Sequence[str] = AGENTS, acting: Sequence[str] = ACTING) -> list[Job]:
    """Everything that is evaluated: agents, and recordings of those that are acting."""
    every = []
    for year in YEARS:
        seasons = {"test": {"years": [year], "seasons": RUNS}}
        task, season = (design(family, salt, runs=RUNS, splits=seasons) for salt in (DRAWS, RECORDED))
        every += [Job(str(year), task, agent) for agent in agents]
        every += [Job(str(year), task, agent, season) for agent in acting]
    return every


def measure(work: Path, processes: int) -> dict[str, Any]:
    """Score, profit and price of violations of each run [EUR m-2] by year and agent."""
    return {"runs": RUNS, "evaluations": evaluated(jobs(), work, processes)}


def scores(figures: Mapping[str, Any], agent: str, what: str = "reward") -> Scores:
    """Of an agent, by year and season ``(years, seasons)``."""
    return np.array([figures["evaluations"][str(year)][agent][what] for year in YEARS])


def changing_pairs(figures: Mapping[str, Any]) -> list[set[str]]:
    """Pairs of agents that have one order in one year and the other in another."""
    means = {name: scores(figures, name).mean(axis=1) for name in (Path(agent).stem for agent in AGENTS)}
    return [{a, b} for a, b in combinations(means, 2) if len(set(np.sign(means[a] - means[b]))) > 1]


def year_table(figures: Mapping[str, Any], agents: Sequence[str] = AGENTS) -> str:
    """What all agents earn in the seasons of each year, and in all of them with its parts."""
    rows = []
    for agent in sorted((Path(agent).stem for agent in agents), key=lambda agent: -scores(figures, agent).mean()):
        score, profit, violations = (float(scores(figures, agent, what).mean()) for what in MONEY)
        rows.append(
            [f"`{agent}`", *map(plain, scores(figures, agent).mean(axis=1)), f"**{plain(score)}** = {plain(profit)} − {plain(violations)}"]
        )
    return grid(["Agent", *map(str, YEARS), "All = profit − violations"], rows)


def apart_table(figures: Mapping[str, Any], sensible: Sequence[str] = SENSIBLE) -> str:
    """Spread, how stable the order of the sensible agents is, and which difference so many scenarios find."""
    every = np.array([scores(figures, agent) for agent in sensible])
    rows = []
    for label, table in [*((str(year), every[:, place]) for place, year in enumerate(YEARS)), ("all", every.reshape(len(every), -1))]:
        order, found = stability(table), detectable(table)["found"].values()
        shares = (order["same best"], order["pairs in the same order"])
        rows.append([label, *map(plain, spread(table).values()), *map(percent, shares), *(f"{plain(a)} ({plain(b)})" for a, b in found)])
    head = ["Year", "between agents", "between scenarios", "agent × scenario", "same best", "pairs in order"]
    return grid([*head, "found with 30", "found with 100"], rows)


def recording_table(figures: Mapping[str, Any], acting: Sequence[str] = ACTING, zero: str = UNLIT) -> str:
    """What a blind recording of each agent earns."""
    rows = []
    for agent in (Path(agent).stem for agent in acting):
        own, blind, unlit = (scores(figures, name).ravel() for name in (agent, f"recording_of_{agent}", zero))
        told = recorded(own, blind, unlit)
        rows.append(
            [f"`{agent}`", plain(own.mean()), signed(told["lead"]), plain(blind.mean()), plain(told["lost"]), percent(told["below"])]
        )
    return grid(["Agent", "Score", f"Lead over `{zero}`", "Its recording", "Lost", f"Seasons below `{zero}`"], rows)


TABLES: Tables = {"years": year_table, "apart": apart_table, "recordings": recording_table}


if __name__ == "__main__":
    write(__doc__, FIGURES, PAGE, TABLES, measure)
