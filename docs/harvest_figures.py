"""Tables of docs/lettuce.md on the day of harvest: ``python -m docs.harvest_figures [--runs 24] [--only-page] [--rules FOLDER]``.

Growers with the same climate, that of ``rule_based_greenhouse`` for lettuce, call the crew by different signs. The number of each sign (a
day, a sum of light, a mass) is the best of a list in seasons of the training split, and earns what the table says in others of the
validation split. All of them play side by side, in one simulation. ``--rules`` keeps the results of ``glbench evaluate`` in FOLDER of the
agents in ``RULES`` besides, for the table of more seasons.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docs.benchmark_design_figures import DOCS, ROOT, filled, grid, read
from glbench.agents.harvest_rules import HARVEST, HarvestRulesAgent, HarvestRuleSettings
from glbench.agents.tuned_rules import read_rule_page
from glbench.env import Simulation
from glbench.evaluation import load_result
from glbench.leaderboard.ladder import Rung, Share, share_of
from glbench.leaderboard.statistics import Interval, estimate_difference, estimate_mean
from glbench.model.crop.lettuce import head_mass
from glbench.resources import data_folder, write_atomically
from glbench.tasks import get_task, task_card
from glbench.tasks.spec import TaskSpec
from glbench.vision import Encoder

TASK = "LettuceHarvest-v1"
WITH_PICTURES: Mapping[str, Any] = {
    "camera": {"library": "lettuce-2"},
    "observation.modules": [*get_task(TASK).observation.modules, "camera"],
}
"""A camera besides: it changes nothing else."""
PAGE, FIGURES, RULE_FIGURES = DOCS / "lettuce.md", DOCS / "measurements" / "harvest.json", DOCS / "measurements" / "harvest-rules.json"
CLIMATE = ROOT / "baselines" / "rule_based_greenhouse" / "rules" / "lettuce-v2.yml"
FIRST_SEED = {"training": 30_000_000_000, "validation": 10_000}
DEFAULT = 40
"""Days after which the grower of reference cuts: about as many as the plants of the books need in mean weather of March and April."""
SIGNS: Mapping[str, Sequence[float]] = {
    "day": (27, 30, 33, 36, 38, 40, 42, 44, 46, 50, 54),
    "light": (400, 450, 500, 550, 600, 650),
    "dates": (0, 1, 2, 3, 4, 5, 6),
    "books": (310, 330, 350, 370, 390),
    "sample": (320, 340, 360),
    "picture": (300, 320, 340, 360, 380),
    "mass": (320, 335, 350, 365, 380),
}
DATES = ((32, 28), (34, 30), (36, 32), (38, 34), (40, 32), (42, 33), (46, 29))
"""What the crew is called by: days since planting; MJ m-2 of radiation since then, as measured; one of ``DATES``, days since planting for
the first and the second planting; mass [g] that plants of the books would
have in a house of the books in that weather; mass [g] that weekly samples tell; mass [g] that the encoder makes of the picture of the
day; true mass [g]."""
WORDS = {
    "reference": f"after {DEFAULT} days",
    "day": "after the best number of days",
    "light": "after the best sum of light",
    "dates": "after the best two numbers of days, one for each planting",
    "books": "when plants of the books would be heavy enough, weather known",
    "sample": "when the weekly sample says so",
    "picture": "when the picture of the day says so",
    "mass": "when the true mass says so",
    "hindsight": "best of all these in each season, in hindsight",
}
RULES = {
    "rule_based_harvest_day": f"after {DEFAULT} days",
    "rule_based_harvest_46": "after 46 days",
    "rule_based_harvest": "when the weekly sample says so, at 360 g",
}
"""Folders of rules that are evaluated in more seasons: the one that leads are counted over, the best blind one, the one that looks."""
BLIND = ("reference", "day", "light", "dates", "books")
_GAIN, _PART = 11.0, 0.6  # g day-1 after a sample, and the part of a new sample in what is thought
_STEPS_A_DAY = 96
Floats = NDArray[np.float64]


class Grower(HarvestRulesAgent):
    """The rules of the climate, with one sign for each row."""

    def __init__(self, task: TaskSpec, signs: Sequence[tuple[str, float]], runs: int, calls: NDArray[np.bool_]) -> None:
        numbers = read_rule_page(CLIMATE).numbers.model_dump()
        pages = []
        for sign, value in signs:
            days, mass = (value if sign in ("day", "reference") else 100.0), (value if sign == "sample" else 0.0)
            own = {"harvest_days": days, "harvest_mass": mass, "harvest_growth": _GAIN, "harvest_sample": _PART}
            pages += [HarvestRuleSettings(**numbers, **own)] * runs
        super().__init__(pages)
        self.reset(task_card(task), len(pages))
        self.signs = np.repeat([sign for sign, _ in signs], runs)
        self.values = np.repeat([value for _, value in signs], runs)
        self.calls, self.true, self.light, self.step = calls, np.zeros(len(pages)), np.zeros(len(pages)), 0
        self.pictured = np.zeros(len(pages))

    def _harvest(self, readings: dict[str, Floats]) -> Floats:
        young = readings["days_since_planting"] < 0.05
        self.light = np.where(young, 0.0, self.light + readings["global_radiation"] * 900e-6)
        heavy = (self.signs == "mass") & (self.true >= self.values)
        sunny = (self.signs == "light") & (self.light >= self.values)
        taken = readings["days_since_planting"] >= 1.0  # a picture of these plants, at noon
        large = (self.signs == "picture") & (self.pictured >= self.values) & taken
        called = np.where((heavy | sunny | large) & ~young, 1.0, super()._harvest(readings))
        self.step += 1
        return np.where(self.calls[:, self.step - 1], 1.0, called)


def play(task: TaskSpec, seeds: Sequence[int], signs: Sequence[tuple[str, float]], calls: NDArray[np.bool_]) -> dict[str, Any]:
    """Score and profit [EUR m-2] and days of harvest of each sign (first axis) in each run; ``calls`` are steps of further harvests."""
    rows = len(signs) * len(seeds)
    simulation = Simulation(task, rows, "fast")
    observations, grower = simulation.reset(list(seeds) * len(signs)), Grower(task, signs, len(seeds), calls)
    model, p = task.model_value, task.model_value.Parameters(*task.parameters().tolist())
    cameras = [place for place, column in enumerate(task.observed()) if column.name.startswith("camera_")]
    encoder = Encoder.at(data_folder("images") / f"{task.camera.library}.encoder.npz") if task.camera is not None else None
    place, crew = model.control_names.index(HARVEST), np.zeros(rows)
    sums, days = np.zeros((2, rows)), [[] for _ in range(rows)]
    for step in range(task.steps):
        grower.true = np.asarray(head_mass(model.State(*simulation.x.T), p))
        if encoder is not None:
            grower.pictured = encoder.estimates(observations[:, cameras])[:, 0]
        result = simulation.step(grower.act(observations))
        observations = result.observations
        sums += [result.quantities["reward"], result.quantities["epi"]]
        now = simulation.u[:, place]
        for row in np.flatnonzero(now > crew):
            days[row].append(round(step / _STEPS_A_DAY, 2))
        crew = now.copy()
    shape = (len(signs), len(seeds))
    score, profit = sums.reshape(2, *shape).round(4).tolist()
    return {"score": score, "profit": profit, "days": [days[len(seeds) * k : len(seeds) * (k + 1)] for k in range(len(signs))]}


def of_the_books(task: TaskSpec) -> TaskSpec:
    """The task with plants and house of the books, in the same weather: what a blind planner can know."""
    scenario = task.file.scenario.model_copy(update={"parameters": (), "start": ()})
    return type(task)(task.file.model_copy(update={"scenario": scenario}), task.source).in_split(task.split)


def measure(runs: int) -> dict[str, Any]:
    """All signs in both splits."""
    figures: dict[str, Any] = {"runs": runs, "signs": [["reference", DEFAULT]]}
    figures["signs"] += [[sign, value] for sign, values in SIGNS.items() for value in values]
    signs, books = [tuple(one) for one in figures["signs"]], [("mass", value) for value in SIGNS["books"]]
    for split, first in FIRST_SEED.items():
        task, seeds = get_task(TASK).replace(WITH_PICTURES).in_split(split), range(first, first + runs)
        never = np.zeros((len(books) * runs, task.steps), dtype=bool)
        planned = play(of_the_books(task), seeds, books, never)["days"]
        calls = np.zeros((len(signs) * runs, task.steps), dtype=bool)
        start = runs * next(k for k, (sign, _) in enumerate(signs) if sign == "books")
        for row, harvests in enumerate(day for one in planned for day in one):
            calls[start + row, [round(day * _STEPS_A_DAY) for day in harvests]] = True
        for k, (sign, value) in enumerate(signs):
            if sign == "dates":
                first_planting, second = DATES[value]
                rows = slice(runs * k, runs * (k + 1))
                calls[rows, first_planting * _STEPS_A_DAY] = calls[rows, (first_planting + 1 + second) * _STEPS_A_DAY] = True
        figures[split] = play(task, seeds, signs, calls)
    return figures


def chosen(figures: Mapping[str, Any]) -> dict[str, int]:
    """Place of the number of each sign that scores best in training seasons."""
    score = np.array(figures["training"]["score"]).mean(axis=1)
    places: dict[str, int] = {}
    for k, (sign, _) in enumerate(figures["signs"]):
        if sign not in places or score[k] > score[places[sign]]:
            places[sign] = k
    return places


def scores(figures: Mapping[str, Any]) -> dict[str, Floats]:
    """Score of each sign in each validation season [EUR m-2], and the best of all in hindsight."""
    score = np.array(figures["validation"]["score"])
    return {**{sign: score[k] for sign, k in chosen(figures).items()}, "hindsight": score.max(axis=0)}


def shares(figures: Mapping[str, Any]) -> dict[str, float]:
    """Lead of each sign over the reference as a part of that of the best in hindsight [-]."""
    mean = {sign: float(one.mean()) for sign, one in scores(figures).items()}
    return {sign: (one - mean["reference"]) / (mean["hindsight"] - mean["reference"]) for sign, one in mean.items()}


def table(figures: Mapping[str, Any]) -> str:
    """The table of the page."""
    places, share, own = chosen(figures), shares(figures), scores(figures)
    units = {"reference": "days", "day": "days", "light": "MJ/m²"}
    rows = []
    for sign, words in WORDS.items():
        number, first = "", ""
        if sign in places:
            value = figures["signs"][places[sign]][1]
            number = "{} and {} days".format(*DATES[value]) if sign == "dates" else f"{value:g} {units.get(sign, 'g')}"
            harvests = [days[0] for days in figures["validation"]["days"][places[sign]] if days]
            first = f"{np.mean(harvests):.1f} ± {np.std(harvests):.1f}"
        rows.append([words, number, first, f"{own[sign].mean():.2f}", f"{share[sign]:.2f}"])
    return grid(["The crew is called ...", "Number", "First harvest [day]", "Score [EUR/m²]", "Share of the lead"], rows)


def keep_rules(folder: Path) -> None:
    """Keep the values of all runs of ``RULES`` of the results in ``folder``, rounded."""
    results = {name: load_result(folder / "validation" / "results" / TASK / f"{name}.json") for name in RULES}
    values = {name: [round(value, 3) for value in result.values("reward")] for name, result in results.items()}
    first = results["rule_based_harvest"]
    kept = {"task_digest": first.task.digest, "first_seed": first.evaluation.seeds[0], "values": values}
    write_atomically(RULE_FIGURES, json.dumps(kept, separators=(",", ":")) + "\n")


def rule_rungs(figures: Mapping[str, Any]) -> dict[str, Rung]:
    """``RULES`` as rungs of a ladder."""
    return {name: Rung(name=name, kind="other", columns=None, seeds=(), values=(figures["values"][name],)) for name in RULES}


def what_looking_is_worth(figures: Mapping[str, Any]) -> tuple[Share, Interval]:
    """Share of the lead that the best blind rules keep, and what the rules that look earn more than they do [EUR m-2]."""
    zero, blind, looks = rule_rungs(figures).values()
    share = share_of(blind, looks, zero)
    assert share is not None
    return share, estimate_difference([looks.matrix], [blind.matrix], fixed=(True, True)).interval()


def rules_table(figures: Mapping[str, Any]) -> str:
    """The table of the page in more seasons."""
    rungs = rule_rungs(figures)
    zero, blind, _ = rungs
    cells = []
    for name, rung in rungs.items():
        mean = estimate_mean([rung.matrix]).interval()
        lead = estimate_difference([rung.matrix], [rungs[zero].matrix], fixed=(True, True)).interval()
        of_lead = what_looking_is_worth(figures)[0].words if name == blind else "–"
        cells.append([RULES[name], _words(mean), "–" if name == zero else _words(lead), of_lead])
    return grid(["The crew is called ...", "Score [EUR/m²]", "Lead [EUR/m²]", "Share of the lead"], cells)


def _words(interval: Interval) -> str:
    return f"{interval.value:.2f} ({interval.low:.2f} to {interval.high:.2f})"


def best_days(figures: Mapping[str, Any]) -> Floats:
    """Days since planting at which each validation season is best cut, of the list of ``SIGNS``."""
    places = [k for k, (sign, _) in enumerate(figures["signs"]) if sign == "day"]
    score = np.array(figures["validation"]["score"])[places]
    return np.array(SIGNS["day"], dtype=float)[score.argmax(axis=0)]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24, help="seasons of each split")
    parser.add_argument("--only-page", action="store_true", help="do not simulate: write the table from the figures that are there")
    parser.add_argument("--rules", type=Path, metavar="FOLDER", help="keep the results of the rules in this folder")
    given = parser.parse_args()
    if given.rules is not None:
        keep_rules(given.rules)
    if not given.only_page:
        write_atomically(FIGURES, json.dumps(measure(given.runs)) + "\n")
    figures = read(FIGURES)
    page = filled(PAGE.read_text(encoding="utf-8"), figures, {"harvest": table})
    write_atomically(PAGE, filled(page, read(RULE_FIGURES), {"harvest_rules": rules_table}))
    sys.stdout.write(f"{table(figures)}\nbest days {np.percentile(best_days(figures), [0, 10, 50, 90, 100])}\n")


if __name__ == "__main__":
    main()
