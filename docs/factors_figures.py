"""The tables and the figure of docs/factors.md, from the cells played so far: ``python -m docs.factors_figures [WORK ...]``.

Given work folders of the study (`benchmarks/factors.py`), it first adds their numbers to those in docs/measurements/factors.json.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.factors_table import write_tables
from docs.benchmark_design_figures import DOCS, grid, read
from docs.study_figures import AGENTS, BLACK, HEIGHT, Mark, panel, svg
from docs.tables import with_tables
from glbench.leaderboard.statistics import Interval
from glbench.resources import write_atomically

PAGE, FIGURES, PICTURE = DOCS / "factors.md", DOCS / "measurements" / "factors.json", DOCS / "images" / "factors.svg"
WORDS = {"rules": "tuned rules", "ppo": "PPO", "ppo_memory": "PPO with a memory", "mpc": "predictive control"}
DRAWN = {
    "mpc - rules": ("Predictive control − rules", AGENTS["mpc"]),
    "ppo_memory - rules": ("PPO − rules", AGENTS["ppo_memory"]),
    "mpc - ppo_memory": ("Predictive control − PPO", BLACK),
}
"""Differences of the figure, from left to right: title and colour. This PPO has a memory."""
Cells = Mapping[str, Mapping[str, Any]]


def played(base: Mapping[str, Any]) -> Cells:
    """The cells in which agents can be compared."""
    return {key: cell for key, cell in base["cells"].items() if cell["pairs"]}


def words_of(key: str) -> str:
    """A cell in words: ``spring.house-2`` is house: 2."""
    return key.partition(".")[2].replace("-", ": ", 1)


def agents_in(kinds: str) -> str:
    """An agent, or two, in words."""
    return " − ".join(WORDS[kind] for kind in kinds.split(" - "))


def span(figures: Mapping[str, Any]) -> str:
    """A value with its interval."""
    numbers = [f"{figures[key]:z.2f}".replace("-", "−") for key in ("value", "low", "high")]
    return f"{numbers[0]} ({numbers[1]} to {numbers[2]})"


def differences(cells: Cells) -> str:
    """What the first agent earns more than the second in every cell, with the verdict on the conclusion of the centre."""
    pairs = dict.fromkeys(pair for cell in cells.values() for pair in cell["pairs"])
    rows = []
    for key, cell in cells.items():
        row = [cell["pairs"].get(pair) for pair in pairs]
        rows.append([words_of(key), *("–" if one is None else span(one) + _verdict(one) for one in row)])
    return grid(["", *map(agents_in, pairs)], rows)


def _verdict(figures: Mapping[str, Any]) -> str:
    return f"<br>**{figures['verdict']}**" if figures["verdict"] else ""


def scores(cells: Cells) -> str:
    """Scores of all agents in every cell, with the number of trainings and runs behind each."""
    rows = []
    for key, cell in cells.items():
        row = [cell["agents"].get(kind) for kind in WORDS]
        rows.append([words_of(key), *("–" if one is None else f"{span(one)}<br>{_counts(one)}" for one in row)])
    return grid(["", *WORDS.values()], rows)


def _counts(figures: Mapping[str, Any]) -> str:
    trainings = f"{figures['trainings']} × " if figures["trainings"] > 1 else ""
    return f"{trainings}{figures['runs']} runs"


def effects(base: Mapping[str, Any], *, of_pairs: bool) -> str:
    """What each change of a factor does to agents, or to differences; without effects that are only known of agents without training."""
    known = {(one["effect"], one["on"]): one for one in base["effects"]}
    heads = [kinds for kinds in dict.fromkeys(kinds for _, kinds in known) if (" - " in kinds) == of_pairs]
    rows = []
    for effect in dict.fromkeys(effect for effect, _ in known):
        if (effect, "ppo") in known:
            row = [known.get((effect, kinds)) for kinds in heads]
            rows.append([effect.removesuffix(", from the centre"), *("–" if one is None else span(one) for one in row)])
    return grid(["", *map(agents_in, heads)], rows)


def tables(figures: Mapping[str, Any]) -> dict[str, str]:
    """The tables by their places."""
    drawn = {}
    for name, base in figures["bases"].items():
        drawn |= {f"factors_{name}": differences(played(base)), f"factors_{name}_scores": scores(played(base))}
        drawn |= {
            f"factors_{name}_effects": effects(base, of_pairs=False),
            f"factors_{name}_effects_on_leads": effects(base, of_pairs=True),
        }
    return drawn


def filled(page: str, figures: Mapping[str, Any]) -> str:
    """The page with its tables made again. Raises ``ValueError`` when a table has no place."""
    return with_tables(page, tables(figures))


def picture(figures: Mapping[str, Any]) -> str:
    """One panel per difference and one row per cell of ``Spring-v1``, with 95 % intervals."""
    cells, parts, wide = played(figures["bases"]["spring"]), [], 150
    for place, (pair, (title, colour)) in enumerate(DRAWN.items()):
        rows = []
        for key, cell in cells.items():
            one = cell["pairs"].get(pair)
            marks = [Mark(Interval(value=one["value"], low=one["low"], high=one["high"]), colour)] if one else []
            rows.append((words_of(key) if place == 0 else "", marks))
        parts += panel((110 + (wide + 34) * place, 40), wide, title, rows, "EUR/m²", with_zero=True)
    return svg(660, 40 + HEIGHT * len(cells) + 32, parts)


def main() -> None:
    """Add the numbers of work folders, if any are given; draw the figure and fill in the tables."""
    for work in map(Path, sys.argv[1:]):
        write_tables(work, [FIGURES])
        write_atomically(FIGURES, (work / "factors.json").read_text(encoding="utf-8"))
    figures = read(FIGURES)
    write_atomically(PICTURE, picture(figures))
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8"), figures))


if __name__ == "__main__":
    main()
