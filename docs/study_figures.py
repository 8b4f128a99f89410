"""Tables and the figure of docs/study.md from the released results: ``python -m docs.study_figures``.

Learning against predictive control against tuned rules, on the test splits of the suite ``control``. Where a recipe was trained several
times, its figures are means over the trainings, and intervals cover them too. What is not released is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from docs.reproduction_figures import DOCS, round_ticks, svg, text
from docs.tables import with_tables
from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard.collect import own_and_released_results, published_expectations
from glbench.leaderboard.entries import Entry, entries_by_task
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.ranking import Row, TaskTable, rank
from glbench.leaderboard.statistics import estimate_difference
from glbench.resources import write_atomically

PAGE, FIGURE = DOCS / "study.md", DOCS / "images" / "study.svg"
CONTROL = ("SpringYears-v1", "SpringMismatch-v1", "Spring-v1", "Lettuce-v1")
ADDED = {
    ("SpringYears-v1", "SpringMismatch-v1"): "the house, the leaves and the start differ",
    ("SpringMismatch-v1", "Spring-v1"): "sensors err; CO2 outside wanders; a forecast, which errs",
}
"""What the second task adds to the first; both have the same seasons and crops, run by run."""
NOISE = tuple(f"Schiphol2010-Delta{level:02d}-v1" for level in (0, 10, 30))
TRANSFER = tuple(f"Transfer-{name}-v1" for name in ("Greensboro", "Miami", "SandPoint", "House-HPS2021", "House-LED2021"))
RULES = "rule_based_tuned"
AGENTS = {
    "rule_based_fair": "#aaaaaa",
    "my_agent": "#777777",
    RULES: "#000000",
    "ppo_fast": "#56b4e9",
    "ppo_memory": "#0072b2",
    "ppo_long": "#332288",
    "sac_fast": "#cc79a7",
    "mpc": "#d55e00",
    "best_known": "#009e73",
}
"""Agents of the study with their colours, in the order of the tables."""
DRAWN = tuple(agent for agent in AGENTS if agent != "rule_based_fair")
"""Agents of the figure: those whose scores do not flatten all others."""
LEARNERS = ("ppo_fast", "ppo_memory", "ppo_long", "sac_fast")
OF_THE_PAPER = ("rule_based_fair", "ppo", "sac", "ppo_tuned", RULES, "ppo_fast", "mpc")
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Study:
    """The released results: ranked tables and entries by the task's name without namespace."""

    tables: Mapping[str, TaskTable]
    entries: Mapping[str, Mapping[str, Entry]]

    @classmethod
    def read(cls) -> Study:
        """From reports/released, whatever else was evaluated here."""
        stored, _ = own_and_released_results(DOCS / "nothing of one's own")
        expected = published_expectations()
        tables = {table.task_id.rpartition("/")[2]: table for table in rank(stored, expected)}
        entries = {
            task.rpartition("/")[2]: {entry.name: entry for entry in found} for task, found in entries_by_task(stored, expected).items()
        }
        return cls(tables, entries)

    def rows(self, task: str, agents: Iterable[str]) -> dict[str, Row]:
        """Rows of those agents that have one, by agent."""
        found = {row.agent: row for row in self.tables[task].rows}
        return {agent: found[agent] for agent in agents if agent in found}

    @cached_property
    def parts(self) -> dict[str, str]:
        """Every table of the page, by the name of its marker."""
        return {
            "scores": self.scores(),
            "against": self.against(),
            "costs": self.costs(),
            "noise": self.grid(NOISE, OF_THE_PAPER, 0),
            "transfer": self.grid(TRANSFER, AGENTS, 2),
            "trainings": self.trainings(),
        }

    def scores(self) -> str:
        """A row an agent and task: score, worst tenth, and the regret with its two parts."""
        rows = []
        for task in CONTROL:
            for agent, row in self.rows(task, AGENTS).items():
                score, worst, regret = row.estimates[RANKING_METRIC], row.worst_tenth, row.regret
                span = score.overall or score
                gaps = ["–"] * 3
                if regret is not None and regret.profit is not None and regret.violations is not None:
                    gaps = [f"{part.mean:.2f}" for part in (regret.total, regret.profit, regret.violations)]
                tail = "–" if worst is None else f"{worst.value:.2f}"
                rows.append([f"`{task}`", f"`{agent}`", f"{score.mean:.2f}", f"{span.low:.2f} to {span.high:.2f}", tail, *gaps])
        head = ["task", "agent", "score", "95 %", "worst tenth", "regret", "of it profit", "of it violations"]
        return _table(head, rows, words=2)

    def against(self) -> str:
        """What learners and predictive control earn more than the tuned rules, run by run."""
        rows = []
        for task in CONTROL:
            entries = self.entries[task]
            for agent in (*LEARNERS, "mpc"):
                if agent not in entries:
                    continue
                pair = compare_entries(entries[agent], entries[RULES])
                metric = pair.metrics[RANKING_METRIC]
                assert metric.difference is not None  # every result states what ranks
                span = metric.difference
                money = [_signed(pair.gap("epi") or 0.0), _signed(-(pair.gap("penalty") or 0.0))]
                wins = (entries[agent].values(RANKING_METRIC) > entries[RULES].values(RANKING_METRIC)).mean()
                rows.append(
                    [
                        f"`{task}`", f"`{agent}`", _signed(metric.difference.value), f"{_signed(span.low)} to {_signed(span.high)}",
                        *money, f"{100 * wins:.0f} %",
                    ]
                )  # fmt: skip
        head = ["task", "agent", "more than the tuned rules", "95 %", "by profit", "by fewer violations", "runs ahead"]
        return _table(head, rows, words=2)

    def costs(self) -> str:
        """What an agent loses from one task to the next on the same seasons and crops, run by run."""
        rows = []
        for (before, after), words in ADDED.items():
            for agent in AGENTS:
                pair = [self.entries[task].get(agent) for task in (before, after)]
                if pair[0] is None or pair[1] is None:
                    continue
                seeds = sorted(set(pair[0].seeds) & set(pair[1].seeds))
                values = [_on(entry, seeds) for entry in pair if entry is not None]
                change = estimate_difference([values[1]], [values[0]]).interval()
                rows.append([words, f"`{agent}`", _signed(change.value), f"{_signed(change.low)} to {_signed(change.high)}"])
        return _table(["what is added", "agent", "change of the score", "95 %"], rows, words=2)

    def grid(self, tasks: Iterable[str], agents: Iterable[str], digits: int) -> str:
        """Scores: a row an agent, a column a task."""
        shown, names = [task for task in tasks if task in self.tables], list(agents)
        found = {task: self.rows(task, names) for task in shown}
        rows = []
        for agent in names:
            cells = [found[task].get(agent) for task in shown]
            if any(cells):
                rows.append([f"`{agent}`", *("–" if row is None else f"{row.means[RANKING_METRIC]:,.{digits}f}" for row in cells)])
        return _table(["", *(f"`{task}`" for task in shown)], rows, words=1)

    def trainings(self) -> str:
        """Scores of the single trainings of every recipe, on the test split, with what they took."""
        rows = []
        for task in CONTROL:
            for agent, row in self.rows(task, LEARNERS).items():
                each = [f"{one.means[RANKING_METRIC]:.2f}" for one in row.results]
                steps = sum(one.training_steps or 0 for one in row.results) / len(each)
                minutes = sum(60 * (one.training_hours or 0.0) for one in row.results) / len(each)
                rows.append([f"`{task}`", f"`{agent}`", ", ".join(each), f"{steps / 1e6:.1f}", f"{minutes:.0f}"])
        return _table(["task", "recipe", "score of each training", "million steps", "minutes"], rows, words=2)


def picture(study: Study) -> str:
    """One panel per task: scores of the agents with their 95 % intervals."""
    width, height, left, top, row_height = 330, 250, 112, 42, 22
    parts = []
    for place, task in enumerate(CONTROL):
        rows = study.rows(task, DRAWN)
        spans = {agent: row.estimates[RANKING_METRIC].overall or row.estimates[RANKING_METRIC] for agent, row in rows.items()}
        marks = round_ticks(min(span.low for span in spans.values()), max(span.high for span in spans.values()))
        x0, y0 = (place % 2) * width, (place // 2) * height

        def x(value: float, x0: int = x0, marks: list[float] = marks) -> float:
            return x0 + left + (width - left - 24) * (value - marks[0]) / (marks[-1] - marks[0])

        parts.append(text(x0 + left, y0 + 24, task, size=13))
        bottom = y0 + top + row_height * len(DRAWN)
        for mark in marks:
            parts.append(f'<line x1="{x(mark):.1f}" x2="{x(mark):.1f}" y1="{y0 + top - 8}" y2="{bottom - 8}" stroke="#e4e4e4"/>')
            parts.append(text(x(mark), bottom + 6, f"{mark:g}", anchor="middle"))
        parts.append(text((x(marks[0]) + x(marks[-1])) / 2, bottom + 22, "score, EUR/m² a season", anchor="middle"))
        for line, (agent, row) in enumerate(rows.items()):
            y, colour = y0 + top + row_height * line + 4, AGENTS[agent]
            parts.append(text(x0 + left - 8, y + 4, agent, anchor="end"))
            span, stroke = spans[agent], f'stroke="{colour}" stroke-width="2"'
            parts.append(f'<line x1="{x(span.low):.1f}" x2="{x(span.high):.1f}" y1="{y}" y2="{y}" {stroke}/>')
            parts.append(f'<circle cx="{x(row.means[RANKING_METRIC]):.1f}" cy="{y}" r="4" fill="{colour}"/>')
    return svg(2 * width, 2 * height, parts)


def filled(page: str, study: Study) -> str:
    """The page with its tables made anew."""
    return with_tables(page, study.parts)


def _on(entry: Entry, seeds: list[int]) -> Floats:
    """What ranks, ``(trainings, runs)``, in the runs with these seeds."""
    return entry.by_training(RANKING_METRIC)[:, [entry.seeds.index(seed) for seed in seeds]]


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _table(head: list[str], rows: list[list[str]], *, words: int) -> str:
    """A table in Markdown whose first ``words`` columns are words and whose others are figures."""
    rule = "|" + "---|" * words + "---:|" * (len(head) - words)
    return "\n".join([_line(head), rule, *map(_line, rows)])


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Draw the figure and fill the tables."""
    study = Study.read()
    write_atomically(FIGURE, picture(study))
    write_atomically(PAGE, filled(PAGE.read_text(encoding="utf-8"), study))


if __name__ == "__main__":
    main()
