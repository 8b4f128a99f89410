"""The tables of a study of factors (`benchmarks/factors.py`): conclusions, cells, years and effects, from the results in a work folder.

All figures are in EUR m-2, with 95 % intervals over runs and trainings by `glbench.leaderboard.statistics`. What is not there is left out.
In `factors.json`, `values` holds an agent's scores: one list per training, in the order of `seeds`, from the first run of the split on.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.factors import NAMESPACE, SAME, Base, Cell, Design, agent_name, cells_of, in_split_of_evaluations, read_result, saved_design
from glbench import __version__
from glbench.env import run_years
from glbench.errors import GlbenchError, refuse
from glbench.leaderboard.statistics import SIGNIFICANCE, Interval, MeanEstimate, corrected, estimate_difference, estimate_mean
from glbench.resources import write_atomically
from glbench.settings import validated
from glbench.tasks import get_task

Array = NDArray[np.float64]
Kinds = tuple[str, ...]  # An agent, or two: the first minus the second
FEWEST_TRAININGS, FEWEST_RUNS = 3, 30  # With fewer the tables are marked as those of a trial
VERDICTS = ("survives", "turns", "not resolved")


@dataclass(frozen=True)
class Scores:
    """What an agent earned in a cell: ``values`` (trainings, runs), of the first runs of the split; ``seeds`` of its trainings, if any."""

    values: Array
    seeds: tuple[int, ...] = ()
    failed: int = 0

    def of(self, seeds: Sequence[int], runs: int) -> Array:
        """Values of the trainings with these seeds, in the first ``runs`` runs; an agent without training repeats its row for each seed."""
        rows = [self.seeds.index(seed) for seed in seeds] if self.seeds else [0] * max(len(seeds), 1)
        return self.values[rows, :runs]


CellScores = Mapping[str, Scores]  # of a cell, by kind of agent


@dataclass(frozen=True)
class Effect:
    """A contrast of cells ``high`` and as many cells ``low``, by their names."""

    words: str
    high: tuple[str, ...]
    low: tuple[str, ...]
    of_trainings: bool


def read_scores(design: Design, work: Path, cell: Cell, metric: str) -> dict[str, Scores]:
    """The results of a cell that are there, by kind of agent; of trainings the runs that all of them have."""
    scores = {}
    for kind in (*design.recipes, *design.bases[cell.base].agents):
        is_trained = kind in design.recipes
        agents = {seed: agent_name(design, cell, kind, seed) for seed in range(design.trainings if is_trained else 1)}
        read = {seed: read_result(design, work, f"{NAMESPACE}/{cell.task}-v1", agent) for seed, agent in agents.items()}
        results = {seed: one for seed, one in read.items() if one is not None}
        if results:
            runs = min(len(result.runs) for result in results.values())
            values = np.array([result.values(metric)[:runs] for result in results.values()])
            scores[kind] = Scores(values, tuple(results) if is_trained else (), sum(len(one.failed) for one in results.values()))
    return scores


def added_scores(file: Path, design: Design) -> dict[str, dict[str, Scores]]:
    """The scores in the ``factors.json`` of another folder, by cell and kind of agent.

    Raises ``GlbenchError`` when there are none, or another design or version of glbench made them: a cell would mean something else.
    """
    if not file.is_file():
        refuse(f"There is no {file}. `python benchmarks/factors.py table --work FOLDER` writes FOLDER/factors.json.", GlbenchError)
    document = json.loads(file.read_text(encoding="utf-8"))
    other, version = validated(Design, document.get("design"), "the design", file, GlbenchError), document.get("glbench")
    differing = [key for key in (*SAME, "bases") if getattr(other, key) != getattr(design, key)]
    differing += [] if version == __version__ else [f"glbench ({version}, here {__version__})"]
    if differing:
        refuse(f"{file} cannot be added, because it has other {', '.join(differing)}. Leave it out, or play its cells again.", GlbenchError)
    return {
        key: {kind: Scores(np.array(one["values"]), tuple(one["seeds"]), one["failed_runs"]) for kind, one in cell["agents"].items()}
        for base in document["bases"].values()
        for key, cell in base["cells"].items()
    }


def paired(scores: Sequence[Scores]) -> list[Array]:
    """Values of agents, cut to the trainings (matched by seed) and runs that all of them have; empty when they share no training."""
    trained = [{*one.seeds} for one in scores if one.seeds]
    seeds, runs = sorted(set[int].intersection(*trained)) if trained else [], min(one.values.shape[1] for one in scores)
    return [] if trained and not seeds else [one.of(seeds, runs) for one in scores]


def contrast(high: Sequence[CellScores], low: Sequence[CellScores], kinds: Kinds) -> tuple[MeanEstimate, Interval] | None:
    """What an agent earns, or the first earns more than the second, in cells ``high``, minus the same in as many cells ``low``, if any.

    Runs with the same seed are paired over all cells, and trainings with the same seed are one unit. Returns an estimate, which is half of
    the effect where both sides have two agents, and the effect with its interval; ``None`` when an agent is missing in a cell, or the cells
    share no training.
    """
    plus, minus = [(cell, kinds[0]) for cell in high], [(cell, kinds[0]) for cell in low]
    for other in kinds[1:]:
        plus, minus = plus + [(cell, other) for cell in low], [(cell, other) for cell in high] + minus
    if any(kind not in cell for cell, kind in plus + minus):
        return None
    values = paired([cell[kind] for cell, kind in plus + minus])
    if not values:
        return None
    first, second, seeds = values[: len(plus)], values[len(plus) :], [range(values[0].shape[1])] * len(plus)
    estimate = estimate_difference(first, second, seeds) if second else estimate_mean(first, seeds)
    interval, scale = estimate.interval(), 2.0 if low and len(kinds) > 1 else 1.0
    return estimate, Interval(value=scale * interval.value, low=scale * interval.low, high=scale * interval.high)


def verdicts(centre: MeanEstimate, others: Mapping[str, MeanEstimate]) -> dict[str, str]:
    """Of a conclusion of the centre in each other cell: survives, turns, or not resolved; empty where the centre has none.

    By p-values of the difference in the other cells, corrected for the number of these cells.
    """
    if centre.p_value() >= SIGNIFICANCE or not others:
        return {}
    p_values = corrected([one.p_value() for one in others.values()])
    words = {}
    for (key, one), p_value in zip(others.items(), p_values, strict=True):
        words[key] = VERDICTS[2] if p_value >= SIGNIFICANCE else VERDICTS[0] if one.value * centre.value > 0.0 else VERDICTS[1]
    return words


def effects_of(name: str, base: Base, cells: Mapping[str, Cell]) -> list[Effect]:
    """One factor at a time from the centre; then main effects of the corners, and those of two factors that cannot be told apart."""
    effects = []
    for factor, one in base.factors.items():
        for level in (level for level in one.levels if level != one.centre):
            words = f"{factor}: {one.centre} to {level}, from the centre"
            effects.append(Effect(words, (f"{name}.{factor}-{level}",), (f"{name}.centre",), one.is_budget))
    corners = [(key, cell.signs) for key, cell in cells.items() if cell.signs is not None]
    columns: dict[tuple[int, ...], list[str]] = {}
    for factor in base.corners.levels:
        columns[tuple(signs[factor] for _, signs in corners)] = [f"{factor}: {' to '.join(base.corners.levels[factor])}, in the corners"]
    for one_factor, other in itertools.combinations(base.corners.levels, 2):
        columns.setdefault(tuple(signs[one_factor] * signs[other] for _, signs in corners), []).append(f"{one_factor} × {other}")
    for signs, names in columns.items():
        high, low = (tuple(key for (key, _), sign in zip(corners, signs, strict=True) if sign == side) for side in (1, -1))
        alone = base.factors.get(names[0].partition(":")[0])
        effects.append(Effect(" or ".join(names), high, low, alone is not None and alone.is_budget))
    return effects


def figures_of(design: Design, work: Path, name: str, added: Mapping[str, CellScores] = MappingProxyType({})) -> dict[str, Any]:
    """All figures of a base, as plain values: cells, conclusions and effects. ``added`` has scores that the work folder lacks."""
    base, cells = design.bases[name], {key: cell for key, cell in cells_of(design).items() if cell.base == name}
    task, centre = in_split_of_evaluations(get_task(base.task), design.split), f"{name}.centre"
    read = {key: {**added.get(key, {}), **read_scores(design, work, cell, task.evaluation.metric)} for key, cell in cells.items()}
    scores = {key: one for key, one in read.items() if one}
    most = max((one.values.shape[1] for of_cell in scores.values() for one in of_cell.values()), default=0)
    years = np.array(run_years(task, tuple(range(task.evaluation.first_seed, task.evaluation.first_seed + most))))

    def figures(kinds: Kinds, key: str, interval: Interval) -> dict[str, Any]:
        each = [values.mean(axis=0) for values in paired([scores[key][kind] for kind in kinds])]
        runs = each[0].size
        values, of = each[0] - (each[1] if len(each) > 1 else 0.0), years[:runs]
        return interval.model_dump() | {"runs": runs, "by_year": {str(year): float(values[of == year].mean()) for year in np.unique(of)}}

    def is_centre(key: str, kinds: Kinds) -> bool:
        return cells[key].task == centre and key != centre and not {*kinds} & {*design.recipes}

    document: dict[str, Any] = {"task": base.task, "cells": {}, "conclusions": [], "effects": []}
    for key, of_cell in scores.items():
        agents = {kind: figures((kind,), key, mean[1]) for kind in of_cell if (mean := contrast([of_cell], [], (kind,)))}
        counts = {
            kind: {"trainings": len(one.values), "seeds": one.seeds, "failed_runs": one.failed, "values": one.values.tolist()}
            for kind, one in of_cell.items()
        }
        levels = dict(cells[key].levels)
        document["cells"][key] = {"levels": levels, "agents": {kind: agents[kind] | counts[kind] for kind in of_cell}, "pairs": {}}
    for pair in design.pairs:
        comparable = [key for key in cells if not is_centre(key, pair)]
        every = {key: lead for key in comparable if key in scores and (lead := contrast([scores[key]], [], pair))}
        words = verdicts(every[centre][0], {key: one[0] for key, one in every.items() if key != centre}) if centre in every else {}
        for key, (_, interval) in every.items():
            document["cells"][key]["pairs"][_less(pair)] = figures(pair, key, interval) | {"verdict": words.get(key)}
        if centre in every:
            lists = {word: [key for key, one in words.items() if one == word] for word in VERDICTS}
            missing = [key for key in comparable if key not in every]
            document["conclusions"].append({"of": _less(pair), **every[centre][1].model_dump(), **lists, "missing": missing})
    for effect in effects_of(name, base, cells):
        for kinds in [*((kind,) for kind in (*design.recipes, *base.agents)), *design.pairs]:
            is_idle = effect.of_trainings and not {*kinds} & {*design.recipes}
            if not is_idle and all(key in scores for key in effect.high + effect.low):
                size = contrast([scores[key] for key in effect.high], [scores[key] for key in effect.low], kinds)
                document["effects"] += [{"effect": effect.words, "on": _less(kinds), **size[1].model_dump()}] if size else []
    return document


def write_tables(work: Path, others: Iterable[Path] = ()) -> str:
    """Write ``factors.json`` and ``factors.md`` of what a work folder holds, and the files ``factors.json`` of others; the page.

    Where several have an agent in a cell, the work folder counts, then the last file. Raises ``GlbenchError`` when the folder holds no
    study, or a file cannot be added.
    """
    design, added = saved_design(work), dict[str, dict[str, Scores]]()
    for file in others:
        for key, scores in added_scores(file, design).items():
            added[key] = added.get(key, {}) | scores
    bases = {name: one for name in design.bases if (one := figures_of(design, work, name, added))["cells"]}
    document = {"schema": "glbench/factors", "schema_version": 1, "glbench": __version__}
    document |= {"design": design.model_dump(mode="json"), "bases": bases}
    page = page_of(design, bases)
    write_atomically(work / "factors.json", json.dumps(document, indent=1) + "\n")
    write_atomically(work / "factors.md", page)
    return page


def page_of(design: Design, bases: Mapping[str, Any]) -> str:
    """The tables in Markdown."""
    is_trial = any(
        one["runs"] < FEWEST_RUNS or (kind in design.recipes and one["trainings"] < FEWEST_TRAININGS)
        for base in bases.values()
        for cell in base["cells"].values()
        for kind, one in cell["agents"].items()
    )
    parts = [
        f"# Factors: {design.split} split, runs: {design.runs}, trainings: {design.trainings}, steps at budget 1: {design.steps:,}",
        *(["**A trial, not a result**: some agents have too few runs or trainings to draw conclusions from."] if is_trial else []),
        "EUR/m², with 95 % intervals over runs and trainings; where an agent has one training, it stands for itself alone. Verdicts are "
        "corrected for the number of cells, intervals are not.",
    ]
    for name, figures in bases.items():
        rows = []
        for one in figures["conclusions"]:
            is_open = one["low"] <= 0.0 <= one["high"]
            lists = ["–"] * 3 if is_open else [_names(one[word]) for word in VERDICTS]
            rows.append([one["of"], _words(one) + (" not resolved" if is_open else ""), *lists, str(len(one["missing"]))])
        parts += [f"## {name}: {figures['task']}", "Conclusions of the centre, and the cells in which they survive:"]
        parts.append(_grid(["", "in the centre", *VERDICTS, "cells not there"], rows))
        pairs = [_less(pair) for pair in design.pairs]
        rows = [[key, *(_words(cell["pairs"].get(pair)) for pair in pairs)] for key, cell in figures["cells"].items() if cell["pairs"]]
        parts += ["Differences in each cell:", _grid(["cell", *pairs], rows)]
        rows = []
        for key, cell in figures["cells"].items():
            for what, one in (cell["agents"] | cell["pairs"]).items():
                counts = [str(one.get("trainings", "")), str(one["runs"]), str(one.get("failed_runs", ""))]
                rows.append([key, what, *counts, _words(one), ", ".join(f"{year}: {mean:.2f}" for year, mean in one["by_year"].items())])
        parts += ["Each year apart, by the year that most of a season's days are from:"]
        parts.append(_grid(["cell", "", "trainings", "runs", "failed runs", "all", "mean by year"], rows))
        rows = [[one["effect"], one["on"], _words(one)] for one in figures["effects"]]
        parts += ["Effects of factors, on agents and on differences:", _grid(["effect", "on", "EUR/m²"], rows)]
    return "\n\n".join(parts) + "\n"


def _grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def _words(figures: Mapping[str, Any] | None) -> str:
    if figures is None:
        return "–"
    verdict = figures.get("verdict")
    return f"{figures['value']:.2f} ({figures['low']:.2f} to {figures['high']:.2f})" + (f" {verdict}" if verdict else "")


def _less(kinds: Kinds) -> str:
    return " - ".join(kinds)


def _names(keys: Sequence[str]) -> str:
    return ", ".join(key.partition(".")[2] for key in keys) or "none"
