"""Tables and figures of docs/study.md and docs/study-tables.md from the released results: ``python -m docs.study_figures``.

Learning against predictive control against tuned rules, on the test splits of the suites ``control`` and ``control-2025``; what information
is worth, from the ladders in docs/measurements (validation split). Where a recipe was trained several times, its figures are means over the
trainings, and intervals cover them too. What is not released is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs import ladder_table
from docs.reproduction_figures import DOCS, round_ticks, svg, text
from docs.tables import with_tables
from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard.collect import StoredResult, published_expectations, read_folder
from glbench.leaderboard.entries import Entry, entries_by_task
from glbench.leaderboard.ladder import Ladder
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.ranking import Row, TaskTable, rank
from glbench.leaderboard.statistics import Interval, estimate_difference
from glbench.resources import write_atomically

PAGE, TABLES = DOCS / "study.md", DOCS / "study-tables.md"
RESULTS = DOCS.parent / "reports" / "released" / "results"
REAL = "GreenhouseReal-v1"
CONTROL = ("SpringYears-v1", "SpringMismatch-v1", "Spring-v1", "Lettuce-v1")
OF_STUDY = (REAL, *CONTROL)
ADDED = {
    ("SpringYears-v1", "SpringMismatch-v1"): "the house, the leaves and the start differ",
    ("SpringMismatch-v1", "Spring-v1"): "sensors err; CO2 outside wanders; a forecast, which errs",
}
"""What the second task adds to the first; both have the same seasons and crops, run by run."""
NOISE = tuple(f"Schiphol2010-Delta{level:02d}-v1" for level in (0, 10, 30))
TRANSFER = tuple(f"Transfer-{name}-v1" for name in ("Greensboro", "Miami", "SandPoint", "House-HPS2021", "House-LED2021"))
GREY, BLACK = "#aaaaaa", "#000000"
AGENTS = {
    "rule_based_fair": GREY,
    "my_agent": "#777777",
    "outdoor": "#999933",
    "rule_based_tuned": BLACK,
    "rule_based_greenhouse": BLACK,
    "ppo_fast": "#56b4e9",
    "ppo_greenhouse": "#56b4e9",
    "ppo_memory": "#0072b2",
    "ppo_memory_greenhouse": "#0072b2",
    "ppo_long": "#332288",
    "sac_fast": "#cc79a7",
    "mpc": "#d55e00",
    "mpc_greenhouse": "#d55e00",
    "best_known": "#009e73",
}
"""Agents of the study with their colours, in the order of the tables."""
DRAWN = tuple(agent for agent in AGENTS if agent != "rule_based_fair")
"""Agents of the figure: those whose scores do not flatten all others."""
WORDS = {
    "best_known": "best known plans",
    "mpc_greenhouse": "predictive control",
    "ppo_memory_greenhouse": "PPO with a memory",
    "ppo_greenhouse": "PPO",
    "rule_based_greenhouse": "tuned rules",
    "sac_fast": "SAC",
    "rule_based_tuned": "rules tuned for Spring-v1",
    "outdoor": "blind PPO",
}
"""What the figure of the default task calls its agents, from above."""
LEARNERS = ("ppo_fast", "ppo_greenhouse", "ppo_memory", "ppo_memory_greenhouse", "ppo_long", "sac_fast")
PLANNERS = ("mpc", "mpc_greenhouse")
KINDS = {
    "mpc": "predictive control",
    "ppo_long": "PPO, memory, 4 × steps",
    "ppo_memory": "PPO with a memory",
    "ppo_fast": "PPO",
    "sac_fast": "SAC",
}
"""Rows of the figure of leads on ``control-2025``."""
COSTLY = ("mpc_greenhouse", "ppo_memory_greenhouse", "ppo_greenhouse", "sac_fast", "rule_based_greenhouse")
"""Agents whose training and decisions the page states, on the default task."""
DUELS = (
    *((REAL, first, second) for first, second in (
        ("mpc_greenhouse", "ppo_memory_greenhouse"), ("mpc_greenhouse", "ppo_greenhouse"), ("best_known", "mpc_greenhouse"),
        ("ppo_memory_greenhouse", "ppo_greenhouse"), ("ppo_memory_greenhouse", "sac_fast"), ("ppo_memory_greenhouse", "outdoor"),
        ("rule_based_greenhouse", "outdoor"), ("rule_based_greenhouse", "rule_based_tuned"),
        ("rule_based_greenhouse", "mpc_greenhouse_book"),
    )),
    *((task, "mpc", second) for task in CONTROL[:3] for second in ("ppo_long", "ppo_memory", "ppo_fast")),
    *((task, "ppo_memory", "ppo_fast") for task in CONTROL),
    *((task, "ppo_long", "ppo_memory") for task in CONTROL[:3]),
)  # fmt: skip
"""Pairs that are compared besides those with the tuned rules."""
CROPS = ("ppo_two_crops", "ppo_one_crop", "ppo_fast", "rule_based_tuned")
"""One policy for two crops, and what it is compared with, on ``Spring-v1`` and ``Lettuce-v1``."""
OF_THE_PAPER = ("rule_based_fair", "ppo", "sac", "ppo_tuned", "rule_based_tuned", "ppo_fast", "mpc")
SENSORS = {
    "without_relative_humidity": "hygrometer",
    "without_pipe_temperature": "pipe temperature",
    "without_co2": "CO2 sensor",
    "without_registration": "weekly crop counts",
    "no_forecast": "forecast",
    "without_air_temperature": "thermometer",
    "without_weather": "weather station",
}
"""Rungs that leave one out, and what they leave out."""
LADDERS = (
    (REAL, "blind", "memory", "GreenhouseReal-v1: PPO"),
    (REAL, "mpc_blind", "mpc", "predictive control"),
    ("Lettuce-v2", "blind", "memory", "Lettuce-v2: PPO"),
    ("Lettuce-v2", "mpc_blind", "mpc", "predictive control"),
    ("Spring-v1", "blind", "memory", "Spring-v1: PPO"),
)
"""Task, its blind and its sighted rung, and what the figure calls the two."""
SCORE, HEIGHT = "EUR/m² a season", 22
LABEL = 16  # Width that the label of a tick needs
Floats = NDArray[np.float64]


def rules_of(task: str) -> str:
    """The rules that were tuned for a task."""
    return "rule_based_greenhouse" if task == REAL else "rule_based_tuned"


@dataclass(frozen=True)
class Study:
    """Released results, and what the tables take from them, by the task's name without namespace."""

    stored: tuple[StoredResult, ...]

    @classmethod
    def read(cls, *tasks: str) -> Study:
        """From reports/released, of these tasks or of all that the pages are about; raises ``ResultError`` for a file that is no result."""
        stored = []
        for task in tasks or (*OF_STUDY, *NOISE, *TRANSFER):
            results, problems = read_folder(RESULTS / task)
            if problems:
                raise problems[0]
            stored += results
        return cls(tuple(stored))

    @cached_property
    def tables(self) -> Mapping[str, TaskTable]:
        """The ranked tables."""
        return {table.task_id.rpartition("/")[2]: table for table in rank(self.stored, published_expectations())}

    @cached_property
    def entries(self) -> Mapping[str, Mapping[str, Entry]]:
        """The entries of each task by name."""
        by_task = entries_by_task(self.stored, published_expectations())
        return {task.rpartition("/")[2]: {entry.name: entry for entry in entries} for task, entries in by_task.items()}

    def rows(self, task: str, agents: Iterable[str]) -> dict[str, Row]:
        """Rows of those agents that have one, by agent."""
        by_agent = {row.agent: row for row in self.tables[task].rows}
        return {agent: by_agent[agent] for agent in agents if agent in by_agent}

    def more(self, task: str, first: str, second: str) -> Interval:
        """What the first agent earns more than the second, run by run, with its 95 % interval [EUR m-2]."""
        span = compare_entries(self.entries[task][first], self.entries[task][second]).metrics[RANKING_METRIC].difference
        assert span is not None  # every result states what ranks
        return span

    @cached_property
    def short(self) -> dict[str, str]:
        """The tables of the page, by the name of their marker."""
        return {"years": self.years()}

    @cached_property
    def parts(self) -> dict[str, str]:
        """Every table of the page behind it, by the name of its marker."""
        return {
            "scores": self.scores(),
            "against": self.against(),
            "duels": self.duels(),
            "every-year": self.every_year(),
            "costs": self.costs(),
            "noise": self.grid(NOISE, OF_THE_PAPER, 0),
            "transfer": self.grid(TRANSFER, AGENTS, 2),
            "crops": self.crops(),
            "trainings": self.trainings(),
            "effort": self.effort(),
        }

    def years(self) -> str:
        """The default task: score in each year, and what training and decisions take."""
        rows = self.rows(REAL, COSTLY)
        cells = [
            [
                WORDS[agent].replace(" ", "&nbsp;"), *(f"{one.mean:.2f}" for one in row.by_year),
                str(len(row.results)) if row.training_steps else "none", _training(row)[1], f"{self._decision(REAL, agent):.2g}",
            ]
            for agent, row in rows.items()
        ]  # fmt: skip
        years = [f"{one.year}, EUR/m²" for one in next(iter(rows.values())).by_year]
        return _table(["", *years, "trainings", "minutes each", "decision, ms"], cells, words=1)

    def scores(self) -> str:
        """A row an agent and task: score, worst tenth, and the regret with its two parts."""
        rows = []
        for task in OF_STUDY:
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
        rows = [
            [f"`{task}`", f"`{agent}`", *self._pair(task, agent, rules_of(task))]
            for task in OF_STUDY
            for agent in (*LEARNERS, *PLANNERS, *(("outdoor",) if task == REAL else ()))
            if agent in self.entries[task]
        ]
        head = ["task", "agent", "more than the tuned rules", "95 %", "by profit", "by fewer violations", "2011", "2012", "runs ahead"]
        return _table(head, rows, words=2)

    def duels(self) -> str:
        """What other pairs earn more than each other, run by run."""
        rows = [[f"`{task}`", f"`{first}`", f"`{second}`", *self._pair(task, first, second)] for task, first, second in DUELS]
        head = ["task", "agent", "beside", "earns more", "95 %", "by profit", "by fewer violations", "2011", "2012", "runs ahead"]
        return _table(head, rows, words=3)

    def every_year(self) -> str:
        """Mean score by weather year: a row a task and agent."""
        rows = []
        for task in OF_STUDY:
            for agent, row in self.rows(task, AGENTS).items():
                means = {one.year: f"{one.mean:.2f} ({one.runs} runs)" for one in row.by_year}
                rows.append([f"`{task}`", f"`{agent}`", *(means.get(year, "–") for year in (2011, 2012))])
        return _table(["task", "agent", "2011", "2012"], rows, words=2)

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
        columns, names = [task for task in tasks if task in self.tables], list(agents)
        scored = {task: self.rows(task, names) for task in columns}
        rows = []
        for agent in names:
            cells = [scored[task].get(agent) for task in columns]
            if any(cells):
                rows.append([f"`{agent}`", *("–" if row is None else f"{row.means[RANKING_METRIC]:,.{digits}f}" for row in cells)])
        return _table(["", *(f"`{task}`" for task in columns)], rows, words=1)

    def crops(self) -> str:
        """The policy for two crops beside specialists and rules: scores, and what it earns more than each, run by run."""
        cells, (both, *_) = [], CROPS
        for task in CONTROL[-2:]:
            rows = self.rows(task, CROPS)
            for agent in (agent for agent in CROPS if agent in rows):
                row, score = rows[agent], score_of(rows[agent])
                each = ", ".join(f"{one.means[RANKING_METRIC]:.2f}" for one in row.results) if len(row.results) > 1 else "–"
                lead = ["–", "–"]
                if agent != both:
                    more = self.more(task, both, agent)
                    lead = [_signed(more.value), f"{_signed(more.low)} to {_signed(more.high)}"]
                cells.append(
                    [f"`{task}`", f"`{agent}`", f"{score.value:.2f}", f"{score.low:.2f} to {score.high:.2f}", each, *_training(row), *lead]
                )
        head = ["task", "agent", "score", "95 %", "each training", "million steps", "minutes", f"`{both}` earns more", "95 %"]
        return _table(head, cells, words=2)

    def trainings(self) -> str:
        """Scores of the single trainings of every recipe, on the test split, with what they took."""
        rows = []
        for task in OF_STUDY:
            for agent, row in self.rows(task, (*LEARNERS, "outdoor")).items():
                each = ", ".join(f"{one.means[RANKING_METRIC]:.2f}" for one in row.results)
                rows.append([f"`{task}`", f"`{agent}`", each, *_training(row)])
        return _table(["task", "recipe", "score of each training", "million steps", "minutes"], rows, words=2)

    def effort(self) -> str:
        """Minutes that the trainings of an agent took on the tasks of the study, and its evaluations there."""
        rows, total = [], np.zeros(3)
        for agent in ("rule_based_tuned", "rule_based_greenhouse", "outdoor", *LEARNERS, *PLANNERS):
            entries = [self.entries[task][agent] for task in OF_STUDY if agent in self.entries[task]]
            trained = [one.training_hours for task in OF_STUDY for row in self.rows(task, (agent,)).values() for one in row.results]
            searches = 1 if agent in map(rules_of, OF_STUDY) else None  # one for all tasks of such rules
            hours = [hour for hour in trained if hour][:searches]
            seconds = [one.result.evaluation.wall_seconds for entry in entries for one in entry.trainings]
            row = np.array([len(hours), 60.0 * sum(hours), sum(seconds) / 60.0])
            total += row
            rows.append([f"`{agent}`", *(f"{number:,.0f}" if number else "–" for number in row)])
        rows.append(["all", *(f"{number:,.0f}" for number in total)])
        return _table(["agent", "trainings", "minutes of training", "minutes of evaluation"], rows, words=1)

    def _pair(self, task: str, first: str, second: str) -> list[str]:
        """Difference, interval, profit, violations, each year and share of runs ahead of two agents, in the runs of both."""
        one, other = (self.entries[task][agent] for agent in (first, second))
        pair, span = compare_entries(one, other), self.more(task, first, second)
        seeds = sorted(set(one.seeds) & set(other.seeds))
        wins = (_on(one, seeds).mean(axis=0) > _on(other, seeds).mean(axis=0)).mean()
        years = [_signed(pair.by_year[year][1]) if year in pair.by_year else "–" for year in (2011, 2012)]
        money = [_signed(pair.gap("epi") or 0.0), _signed(-(pair.gap("penalty") or 0.0))]
        return [_signed(span.value), f"{_signed(span.low)} to {_signed(span.high)}", *money, *years, f"{100 * wins:.0f} %"]

    def _decision(self, task: str, agent: str) -> float:
        """Mean time of a decision for one run [ms]."""
        return float(np.mean([one.result.evaluation.decision_milliseconds for one in self.entries[task][agent].trainings]))


@dataclass(frozen=True)
class Mark:
    """A dot with its interval in a figure; hollow for an agent that is blind."""

    span: Interval
    colour: str
    hollow: bool = False


def panel(
    place: tuple[float, float],
    width: float,
    title: str,
    rows: Sequence[tuple[str, Sequence[Mark]]],
    axis: str = SCORE,
    *,
    room: int = 0,
    with_zero: bool = False,
) -> list[str]:
    """A panel whose grid begins at ``place``, ``width`` wide: a row a label, above an axis; ``room`` for so many rows."""
    (left, top), ends = place, [end for _, marks in rows for mark in marks for end in (mark.span.low, mark.span.high)]
    ends += [0.0] if with_zero else []
    ticks = round_ticks(min(ends), max(ends))
    bottom = top + HEIGHT * (room or len(rows))

    def x(value: float) -> float:
        return left + width * (value - ticks[0]) / (ticks[-1] - ticks[0])

    parts, every = [text(left, top - 18, title, size=12)], 2 if len(ticks) * LABEL > width else 1
    for tick in ticks:
        stroke = "#999999" if tick == 0.0 else "#e4e4e4"
        parts.append(f'<line x1="{x(tick):.1f}" x2="{x(tick):.1f}" y1="{top - 8}" y2="{bottom - 8}" stroke="{stroke}"/>')
        if round(tick / (ticks[1] - ticks[0])) % every == 0:
            parts.append(text(x(tick), bottom + 6, f"{tick:g}", anchor="middle"))
    parts.append(text(left + width / 2, bottom + 22, axis, anchor="middle"))
    for line, (label, marks) in enumerate(rows):
        middle = top + HEIGHT * line + 4
        parts.append(text(left - 8, middle + 4, label, anchor="end"))
        for number, mark in enumerate(marks):
            y = middle + 7 * number - 3.5 * (len(marks) - 1)
            span, fill = mark.span, "#fff" if mark.hollow else mark.colour
            parts.append(
                f'<line x1="{x(span.low):.1f}" x2="{x(span.high):.1f}" y1="{y}" y2="{y}" stroke="{mark.colour}" stroke-width="2"/>'
            )
            parts.append(f'<circle cx="{x(span.value):.1f}" cy="{y}" r="4" fill="{fill}" stroke="{mark.colour}" stroke-width="2"/>')
    return parts


def score_of(row: Row) -> Interval:
    """The score of a row with its interval, over trainings, too, where it has several."""
    score = row.estimates[RANKING_METRIC]
    span = score.overall or score
    return Interval(value=score.mean, low=span.low, high=span.high)


def picture_of_real(study: Study) -> str:
    """The default task: scores of the agents, and what each earns more than the tuned rules, with 95 % intervals."""
    rows, rules = study.rows(REAL, WORDS), rules_of(REAL)
    scores = [(WORDS[agent], [Mark(score_of(row), AGENTS[agent])]) for agent, row in rows.items()]
    leads = [("", [] if agent == rules else [Mark(study.more(REAL, agent, rules), AGENTS[agent])]) for agent in rows]
    parts = panel((150, 40), 225, "Score", scores) + panel((400, 40), 240, "More than the tuned rules, run by run", leads)
    return svg(660, 40 + HEIGHT * len(rows) + 32, parts)


def picture_of_leads(study: Study) -> str:
    """One panel per task of ``control-2025``: what each agent earns more than the tuned rules, with its 95 % interval."""
    parts, wide = [], 100
    for place, task in enumerate(CONTROL):
        entries, rows = study.entries[task], []
        for agent, words in KINDS.items():
            marks = [Mark(study.more(task, agent, rules_of(task)), AGENTS[agent])] if agent in entries else []
            rows.append((words if place == 0 else "", marks))
        parts += panel((150 + (wide + 28) * place, 40), wide, task, rows, "EUR/m²")
    return svg(660, 40 + HEIGHT * len(KINDS) + 32, parts)


def picture_of_ladder(ladders: Sequence[Ladder]) -> str:
    """What blind and sighted agents lead by over rules without lamps, and what each sensor is worth (validation split)."""
    whole = {one.task.rpartition("/")[2]: one for one in ladders if any(rung.name == "blind" for rung in one.rungs)}
    sensors = next(one for one in ladders if one.task.endswith(f"/{REAL}") and any(rung.name in SENSORS for rung in one.rungs))
    leads = []
    for task, blind, sighted, words in LADDERS:
        spans, colour = {row.name: row.lead for row in whole[task].rows}, AGENTS["mpc" if "mpc" in sighted else "ppo_memory"]
        leads.append((words, [Mark(span, colour, name == blind) for name in (blind, sighted) if (span := spans[name]) is not None]))
    steps = {row.name: row.step for row in sensors.rows}
    losses = [
        (words, Interval(value=-step.value, low=-step.high, high=-step.low))
        for name, words in SENSORS.items()
        if (step := steps[name]) is not None
    ]
    losses.sort(key=lambda one: -one[1].value)
    worth = [(words, [Mark(span, BLACK if span.low > 0.0 else GREY)]) for words, span in losses]
    parts = panel((170, 40), 190, "Lead: blind (hollow), sighted (full)", leads, room=len(worth))
    parts += panel((480, 40), 160, "Lost without it", worth)
    return svg(660, 40 + HEIGHT * len(worth) + 32, parts)


def picture(study: Study) -> str:
    """One panel per task of ``control-2025``: scores of the agents with their 95 % intervals."""
    width, height, parts = 330, 272, []
    names = [agent for agent in DRAWN if any(agent in study.entries[task] for task in CONTROL)]
    for place, task in enumerate(CONTROL):
        rows = [(agent, [Mark(score_of(row), AGENTS[agent])]) for agent, row in study.rows(task, names).items()]
        corner = ((place % 2) * width + 112, (place // 2) * height + 42)
        parts += panel(corner, width - 136, task, rows, room=len(names))
    return svg(2 * width, 2 * height, parts)


def filled(page: str, study: Study) -> str:
    """The page with its tables made again."""
    return with_tables(page, study.short)


def filled_tables(page: str, study: Study) -> str:
    """The page behind it with its tables made again."""
    return with_tables(page, study.parts)


def pictures(study: Study) -> dict[Path, str]:
    """The figures by their files."""
    images = DOCS / "images"
    drawn = {
        "study": picture(study),
        "study-real": picture_of_real(study),
        "study-leads": picture_of_leads(study),
        "study-ladder": picture_of_ladder(ladder_table.read()),
    }
    return {images / f"{name}.svg": drawing for name, drawing in drawn.items()}


def _on(entry: Entry, seeds: list[int]) -> Floats:
    """What ranks, ``(trainings, runs)``, in the runs with these seeds."""
    return entry.by_training(RANKING_METRIC)[:, [entry.seeds.index(seed) for seed in seeds]]


def _training(row: Row) -> list[str]:
    """Million steps and minutes of one training, by the mean; nothing of an agent without any."""
    steps, hours = ([getattr(one, name) or 0.0 for one in row.results] for name in ("training_steps", "training_hours"))
    return [f"{np.mean(steps) / 1e6:.1f}", f"{60.0 * np.mean(hours):.0f}"] if any(steps) else ["–", "–"]


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _table(head: list[str], rows: list[list[str]], *, words: int) -> str:
    """A table in Markdown whose first ``words`` columns are words and whose others are figures."""
    rule = "|" + "---|" * words + "---:|" * (len(head) - words)
    return "\n".join([_line(head), rule, *map(_line, rows)])


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Draw the figures and fill the tables."""
    study = Study.read()
    for file, drawing in pictures(study).items():
        write_atomically(file, drawing)
    for page, fill in ((PAGE, filled), (TABLES, filled_tables)):
        write_atomically(page, fill(page.read_text(encoding="utf-8"), study))


if __name__ == "__main__":
    main()
