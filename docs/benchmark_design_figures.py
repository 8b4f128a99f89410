"""Tables of docs/benchmark-design.md: ``python -m docs.benchmark_design_figures [--work runs/design] [--only-page]``.

Evaluates simple controllers, two trained policies and blind recordings of them on seasons made of the training years, drawn with keys
that no split has, so that nothing here has seen a test. Writes docs/measurements/benchmark-design.json and the tables between the markers
of the page. Evaluations that are there already in the work folder are not done again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docs.tables import with_tables
from glbench.env.scenario import run_weather
from glbench.evaluation import Result, evaluate
from glbench.evaluation.evaluation import TRIALS
from glbench.evaluation.files import result_path
from glbench.evaluation.saving import write_recording
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PAGE, FIGURES = DOCS / "benchmark-design.md", DOCS / "measurements" / "benchmark-design.json"

RUNS = 30
YEARS = [2008, 2009, 2010]
DRAWS, OTHER_DRAWS, RECORDED = "design", "design, drawn anew", "design, recorded"
"""Salts: of the scenarios, of others to show what knowing the first ones is worth under a secret salt, and of the recorded run."""

MY_AGENT, PI, CONSTANT, NOTHING, ONE_PAGE = (
    str(ROOT / "submissions" / f"{name}.py") for name in ("my_agent", "pi_controller", "constant_setpoints", "do_nothing", "setpoints")
)
FAIR_UNLIT = "rule_based_fair_unlit"
"""The unlit rules playing by observations, as rule_based_fair plays the lit ones: a card that is made here."""
POLICIES = ("ppo", "ppo_tuned")
"""Trained on the paper's task; they play where the observation is the paper's."""
ACTING = (MY_AGENT, PI, CONSTANT, FAIR_UNLIT, "rule_based_fair")
"""Agents that answer an observation with an action, which a recording can replay; rules set controls, and one never acts."""
LIT = ("rule_based_fair", "rule_based", "ppo_tuned")
"""Agents that spend money on lamps, which never pay at these prices, in all seasons or in some: any task tells them from the others."""
REFERENCE = "rule_based_unlit"
"""The controller whose score a lead is counted from."""
MADE = "made"
"""Folder, in the work folder, of agents that are made here."""
FACTOR_AGENTS = (MY_AGENT, PI, FAIR_UNLIT, "rule_based_unlit")
FACTORS = {
    "seasons": (),
    "crop": ("crop",),
    "leaf": ("leaf",),
    "house": ("house",),
    "start": ("start",),
    "sensors": ("sensors",),
    "all": ("crop", "leaf", "house", "start", "sensors"),
}
FAMILIES = ("SpringYears", "SpringMismatch", "Spring", "SpringSetpoints")
REAL_AGENTS = (MY_AGENT, PI, "rule_based_unlit", "ppo")
CHOICE = {"SpringMismatch": REAL_AGENTS, "Spring": REAL_AGENTS[:-1]}
"""Among which agents one chooses that knows the draws."""
GROWERS: Mapping[str, Mapping[str, str]] = {
    "grower_warmer": {"day = 19.5": "day = 20.5", "pre_night = 16.0": "pre_night = 17.0", "\nnight = 17.0": "\nnight = 18.0"},
    "grower_cooler": {"day = 19.5": "day = 18.5", "pre_night = 16.0": "pre_night = 15.0", "\nnight = 17.0": "\nnight = 16.0"},
    "grower_drier": {"day = 3.0": "day = 3.5", "\nnight = 2.7": "\nnight = 3.2"},
    "grower_little_co2": {"shut = 850.0": "shut = 500.0"},
}
"""Other pages of settings, to be told apart: lines of the grower's, and what stands there instead."""

MONEY = ("reward", "epi", "penalty")
"""Score, profit and price of violations."""

POWER = 1.96 + 0.84
"""Standard errors that a difference must have to be found (5 %, two-sided) in 80 of 100 comparisons."""

Scores = NDArray[np.float64]


def design(name: str, salt: str, without: Iterable[str] = (), runs: int = RUNS, **changes: Any) -> TaskSpec:
    """The task ``name``, v1 where it says no version, with so many scenarios of the training years, under a salt of their own."""
    name = name if "-v" in name else f"{name}-v1"
    return get_task(f"glbench/{name}").replace(
        {
            "id": f"design/{name}",
            "scenario.salt": salt,
            "splits": {"test": {"years": YEARS, "seasons": runs}},
            "evaluation.runs": runs,
            "without": list(without),
            **changes,
        }
    )


def with_factors(kept: Sequence[str], name: str = "Spring") -> TaskSpec:
    """Spring-v1, or another family, with some of the factors of Spring-v1 only; seasons are always unseen."""
    written = get_task("glbench/Spring-v1").as_tables()
    changes = {
        f"scenario.{kind}": [group for group in written["scenario"][kind] if group["name"] in kept] for kind in ("parameters", "start")
    }
    if "sensors" in kept:
        return design(name, DRAWS, sensors=written["sensors"], **changes)
    return design(name, DRAWS, ["sensors"] if name == "Spring" else [], **changes)


def real(name: str) -> TaskSpec:
    """The task ``name`` in the real springs of the training years: the same first days are possible, crops are the same."""
    return design(name, DRAWS, ["scenario.generated"], splits={"test": {"years": YEARS}})


@dataclass(frozen=True)
class Job:
    """An agent on a task; results lie in the folder of the ``label``. With ``recorded``, a recording of the agent's first run there."""

    label: str
    task: TaskSpec
    agent: str
    recorded: TaskSpec | None = None

    @property
    def name(self) -> str:
        """What the agent is called in the figures."""
        stem = Path(self.agent).stem
        return stem if self.recorded is None else f"recording_of_{stem}"

    def result(self, work: Path) -> Result:
        """The result, evaluated if it is not there."""
        sys.stdout.write(f"{self.label}: {self.name}\n")
        agent = self._agent(work)
        result = evaluate(self.task, agent, out=self._folder(work))
        failed = [run.reason for run in result.runs if run.status != "ok"]
        if failed:
            msg = f"{self.name} on {self.label}: {failed[0]}"
            raise RuntimeError(msg)
        return result

    def file(self, work: Path) -> Path:
        """Where the result lies."""
        return result_path(self._folder(work), self.task.id, self.name)

    def _folder(self, work: Path) -> Path:
        return work / re.sub(r"\W+", "-", self.label)

    def _agent(self, work: Path) -> str:
        made = work / MADE / self.agent
        agent = str(made) if made.is_dir() else self.agent
        if self.recorded is None:
            return agent
        stem = Path(self.agent).stem
        folder = work / "recordings" / f"{self.recorded.short_id}-{stem}" / f"recording_of_{stem}"
        where = work / re.sub(r"\W+", "-", f"{self.label} recorded")
        evaluate(self.recorded, agent, runs=1, out=where)
        shutil.rmtree(folder, ignore_errors=True)
        write_recording(result_path(where / TRIALS, self.recorded.id, stem), self.recorded.evaluation.first_seed, folder)
        return str(folder)


def make_agents(work: Path) -> None:
    """Write the folders of agents that are made here: growers with other pages of settings, and the unlit rules that play fair.

    Raises
    ------
    ValueError
        When a line that is to be changed is not there.
    """
    baselines = ROOT / "baselines"
    unlit = work / MADE / FAIR_UNLIT
    unlit.mkdir(parents=True, exist_ok=True)
    shutil.copy(baselines / "rule_based_unlit" / "rule_based_unlit.yml", unlit)
    fair = {"../rule_based/rule_based.yml": "rule_based_unlit.yml"}
    write_atomically(unlit / "card.toml", _changed(baselines / "rule_based_fair" / "card.toml", fair))
    for name, lines in GROWERS.items():
        folder = work / MADE / name
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / "settings.toml", _changed(baselines / "grower" / "settings.toml", lines))
        shutil.copy(baselines / "grower" / "card.toml", folder)


def _changed(file: Path, lines: Mapping[str, str]) -> str:
    text = file.read_text(encoding="utf-8")
    for line, other in lines.items():
        if text.count(line) != 1:
            msg = f"{file} has {text.count(line)} times '{line.strip()}', which is to be changed once. Correct GROWERS."
            raise ValueError(msg)
        text = text.replace(line, other)
    return text


def jobs() -> list[Job]:
    """Everything that is evaluated."""
    found = []
    for name in FAMILIES:
        task, recorded = design(name, DRAWS), design(name, RECORDED)
        setpoints, papers = name == "SpringSetpoints", name in ("SpringYears", "SpringMismatch")
        agents = (
            ("grower", *GROWERS, ONE_PAGE)
            if setpoints
            else (*ACTING, "rule_based_unlit", "rule_based", NOTHING, *(POLICIES if papers else ()))
        )
        found += [Job(name, task, agent) for agent in agents]
        acting = ("grower", "grower_drier") if setpoints else (*ACTING, *(POLICIES if name == "SpringYears" else ()))
        found += [Job(name, task, agent, recorded) for agent in acting]
    found.append(Job("SpringYears", design("SpringYears", DRAWS), "recording"))
    found += [Job("SpringYears real", real("SpringYears"), agent) for agent in REAL_AGENTS]
    found += [Job(f"{name} anew", design(name, OTHER_DRAWS), agent) for name in ("SpringMismatch", "Spring") for agent in CHOICE[name]]
    for factor, kept in FACTORS.items():
        if factor != "all":  # Spring itself
            found += [Job(f"factors {factor}", with_factors(kept), agent) for agent in FACTOR_AGENTS]
        found.append(Job(f"factors {factor}, paper", with_factors(kept, "SpringMismatch"), "ppo"))
    return found


def measure(work: Path, processes: int) -> dict[str, Any]:
    """Score, profit and price of violations of each run [EUR m-2] by label and agent; first days of generated and real seasons."""
    make_agents(work)
    found = evaluated(jobs(), work, processes)
    days = {
        label: first_days(task)
        for label, task in (("SpringYears", design("SpringYears", DRAWS)), ("SpringYears real", real("SpringYears")))
    }
    return {"runs": RUNS, "years": YEARS, "first_days": days, "evaluations": found}


def evaluated(
    asked: Sequence[Job], work: Path, processes: int, kept: Iterable[str] = MONEY
) -> dict[str, dict[str, dict[str, list[float]]]]:
    """By label and agent, each run's metrics among ``kept`` that the task has."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        results = list(pool.map(Job.result, asked, [work] * len(asked)))
    found: dict[str, dict[str, dict[str, list[float]]]] = {}
    for job, result in zip(asked, results, strict=True):
        there = [key for key in kept if key in result.runs[0].metrics]
        found.setdefault(job.label, {})[job.name] = {key: [round(run.metrics[key], 4) for run in result.runs] for key in there}
    return found


def first_days(task: TaskSpec) -> list[int]:
    """Day of the year on which each run starts, 0 on 1 January."""
    starts = [run_weather(task.scored, seed).times[0] for seed in task.evaluation.seeds]
    return [
        int((day.astype("datetime64[h]") + np.timedelta64(12, "h")).astype("datetime64[D]").astype(object).timetuple().tm_yday) - 1
        for day in starts
    ]


# What the figures say.

Table = NDArray[np.float64]
"""Scores ``(agents, runs)``."""


def scores_of(figures: Mapping[str, Any], label: str, agents: Iterable[str]) -> dict[str, Scores]:
    """Score of each run by agent."""
    return {agent: np.array(figures["evaluations"][label][agent]["reward"]) for agent in agents}


def controllers(figures: Mapping[str, Any], label: str, *, lit: bool) -> dict[str, Scores]:
    """Scores of all agents that control: no recordings, and not the one that does nothing. Those that use lamps only if ``lit``."""
    names = figures["evaluations"][label]
    kept = [name for name in names if not name.startswith("recording") and name != "do_nothing" and (lit or name not in LIT)]
    return scores_of(figures, label, kept)


def spread(table: Table) -> dict[str, float]:
    """Standard deviations between agents, between scenarios, and of what is left (agent x scenario)."""
    agents, scenarios = table.mean(axis=1), table.mean(axis=0)
    rest = table - agents[:, None] - scenarios[None] + table.mean()
    return {
        "between agents": float(agents.std(ddof=1)),
        "between scenarios": float(scenarios.std(ddof=1)),
        "agent x scenario": float(np.sqrt((rest**2).sum() / ((len(agents) - 1) * (len(scenarios) - 1)))),
    }


def stability(table: Table, draws: int = 4000) -> dict[str, float]:
    """Share of resampled sets of scenarios with the same order of all agents, the same best, and mean share of pairs kept."""
    order = np.argsort(-table.mean(axis=1))
    picked = np.random.default_rng(2026).integers(0, table.shape[1], (draws, table.shape[1]))
    means = table[:, picked].mean(axis=2)  # (agents, draws)
    again = np.argsort(-means, axis=0)
    first, second = np.array(list(combinations(order, 2))).T  # the first of each pair is the better one
    return {
        "same order": float((again == order[:, None]).all(axis=0).mean()),
        "same best": float((again[0] == order[0]).mean()),
        "pairs in the same order": float((means[first] > means[second]).mean()),
    }


def detectable(table: Table, runs: Iterable[int] = (30, 100)) -> dict[str, Any]:
    """Standard deviation of the difference of two agents in a scenario, and the difference that so many scenarios find in 80 of 100 cases.

    ``pairs`` is the smallest, the median and the largest deviation over all pairs; ``found`` holds by number of runs the difference for
    the median and for the largest.
    """
    paired = sorted(float((a - b).std(ddof=1)) for a, b in combinations(table, 2))
    pairs = (paired[0], float(np.median(paired)), paired[-1])
    return {"pairs": pairs, "found": {n: tuple(POWER * sd / n**0.5 for sd in pairs[1:]) for n in runs}}


def knowing(public: Table, anew: Table) -> dict[str, float]:
    """What an agent gains over the best one that knows which is best in each run of the public draws, there and with other draws."""
    best, runs = public.argmax(axis=0), np.arange(public.shape[1])
    return {
        "public salt": float(public[best, runs].mean() - public.mean(axis=1).max()),
        "secret salt": float(anew[best, runs].mean() - anew.mean(axis=1).max()),
    }


def recorded(own: Scores, recording: Scores, reference: Scores) -> dict[str, float]:
    """What a blind recording of an agent loses, as a multiple of the agent's lead over the reference, and how often it is below that."""
    lost, lead = float((own - recording).mean()), float((own - reference).mean())
    return {
        "lost": lost,
        "lead": lead,
        "multiple": lost / lead if lead > 0.0 else float("nan"),
        "below": float((recording < reference).mean()),
    }


def at_equal_days(generated: Scores, real: Scores, days: Scores, real_days: Scores) -> tuple[float, float]:
    """Mean score in generated less real seasons at equal first days, by a straight line through both, and its standard error."""
    made = np.repeat([1.0, 0.0], [len(generated), len(real)])
    day, score = np.concatenate([days, real_days]), np.concatenate([generated, real])
    inputs = np.stack([np.ones_like(made), made, day - day.mean()], axis=1)
    solution = np.linalg.lstsq(inputs, score, rcond=None)[0]
    variance = ((score - inputs @ solution) ** 2).sum() / (len(score) - 3)
    return float(solution[1]), float(np.sqrt(variance * np.linalg.inv(inputs.T @ inputs)[1, 1]))


# The page.


def signed(value: float) -> str:
    """With its sign, and two decimals."""
    return f"{value:+.2f}".replace("-", "−") if round(value, 2) else "0.00"


def plain(value: float) -> str:
    """With two decimals."""
    return f"{value:.2f}".replace("-", "−")


def percent(share: float) -> str:
    """A share of 1 in whole percent."""
    return f"{100 * share:.0f} %"


def grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, all columns but the first aligned right."""
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def family_table(figures: Mapping[str, Any]) -> str:
    """Score of all agents on each family, and of what profit and violations it is made."""
    return score_table({name: figures["evaluations"][name] for name in FAMILIES})


def score_table(families: Mapping[str, Mapping[str, Any]]) -> str:
    """What all agents but recordings earn, by family and agent."""
    agents = dict.fromkeys(agent for found in families.values() for agent in found if not agent.startswith("recording"))

    def cell(found: Mapping[str, Any], agent: str) -> str:
        if agent not in found:
            return "–"
        score, profit, violations = (float(np.mean(found[agent][key])) for key in MONEY)
        return f"**{plain(score)}** = {plain(profit)} − {plain(violations)}"

    return grid(["Agent", *families], ([f"`{agent}`", *(cell(found, agent) for found in families.values())] for agent in agents))


def factor_table(figures: Mapping[str, Any]) -> str:
    """Mean score with seasons alone, what each factor changes, and the spread that it adds."""
    rows = []
    for agent in (*(Path(agent).stem for agent in FACTOR_AGENTS), "ppo"):
        labels = {factor: f"factors {factor}, paper" if agent == "ppo" else f"factors {factor}" for factor in FACTORS}
        if agent != "ppo":
            labels["all"] = "Spring"
        runs = {factor: scores_of(figures, label, [agent])[agent] for factor, label in labels.items()}
        seasons = runs.pop("seasons")
        changes = [f"{signed(float((with_it - seasons).mean()))} ± {(with_it - seasons).std(ddof=1):.2f}" for with_it in runs.values()]
        rows.append([f"`{agent}`", f"{plain(seasons.mean())} ± {seasons.std(ddof=1):.2f}", *changes])
    return grid(["Agent", "Unseen seasons alone", *(factor for factor in FACTORS if factor != "seasons")], rows)


def spread_table(figures: Mapping[str, Any]) -> str:
    """Spread, and how stable the order is."""
    rows = []
    for name in FAMILIES:
        every, unlit = (np.array(list(controllers(figures, name, lit=lit).values())) for lit in (True, False))
        for which, table in [("all", every), ("lamps off", unlit)] if len(every) > len(unlit) else [("all", every)]:
            found = (*map(plain, spread(table).values()), *map(percent, stability(table).values()))
            rows.append([name, f"{len(table)}, {which}", *found])
    head = ["Family", "agents", "between agents", "between scenarios", "agent × scenario"]
    return grid([*head, "same order", "same best", "pairs in order"], rows)


def recording_table(figures: Mapping[str, Any]) -> str:
    """What a blind recording of each agent earns."""
    rows = []
    for name in FAMILIES:
        found = figures["evaluations"][name]
        reference = scores_of(figures, "Spring" if name == "SpringSetpoints" else name, [REFERENCE])[REFERENCE]
        for agent in (agent for agent in found if agent.startswith("recording")):
            player = "ppo_tuned" if agent == "recording" else agent.removeprefix("recording_of_")
            own, blind = scores_of(figures, name, [player, agent]).values()
            told = recorded(own, blind, reference)
            multiple = "no lead" if np.isnan(told["multiple"]) else f"{told['multiple']:.1f}"
            label = f"`{player}`" + (" (in the paper's season)" if agent == "recording" else "")
            rows.append(
                [
                    name,
                    label,
                    plain(own.mean()),
                    plain(told["lead"]),
                    plain(blind.mean()),
                    plain(told["lost"]),
                    multiple,
                    percent(told["below"]),
                ]
            )
    return grid(
        ["Family", "Agent", "Score", f"Lead over `{REFERENCE}`", "Its recording", "Lost", "Lost / lead", f"Seasons below `{REFERENCE}`"],
        rows,
    )


def real_table(figures: Mapping[str, Any]) -> str:
    """Generated against real seasons of the same years."""
    rows = []
    days, real_days = (np.array(figures["first_days"][label], float) for label in ("SpringYears", "SpringYears real"))
    for agent in (Path(agent).stem for agent in REAL_AGENTS):
        generated, real = (scores_of(figures, label, [agent])[agent] for label in ("SpringYears", "SpringYears real"))
        difference, error = at_equal_days(generated, real, days, real_days)
        rows.append(
            [
                f"`{agent}`",
                f"{plain(generated.mean())} ± {generated.std(ddof=1):.2f}",
                f"{plain(real.mean())} ± {real.std(ddof=1):.2f}",
                f"{signed(difference)} ± {error:.2f}",
            ]
        )
    return grid(["Agent", "Generated, mean ± sd", "Real, mean ± sd", "Generated less real at equal first days, ± standard error"], rows)


def detection_table(figures: Mapping[str, Any]) -> str:
    """Which differences so many scenarios find."""
    rows = []
    for name in FAMILIES:
        told = detectable(np.array(list(controllers(figures, name, lit=False).values())))
        found = [f"{plain(middle)} ({plain(most)})" for middle, most in told["found"].values()]
        rows.append([name, *map(plain, told["pairs"]), *found])
    return grid(["Family", "paired sd, smallest", "median", "largest", "found with 30", "found with 100"], rows)


def knowing_table(figures: Mapping[str, Any]) -> str:
    """What knowing the draws is worth."""
    rows = []
    for name, agents in CHOICE.items():
        names = [Path(agent).stem for agent in agents]
        tables = (np.array(list(scores_of(figures, label, names).values())) for label in (name, f"{name} anew"))
        rows.append([name, *map(signed, knowing(*tables).values())])
    return grid(["Family", "Public salt", "Secret salt"], rows)


Tables = Mapping[str, Callable[[Mapping[str, Any]], str]]
"""What writes the table of each name."""

TABLES: Tables = {
    "families": family_table,
    "factors": factor_table,
    "spread": spread_table,
    "detection": detection_table,
    "recordings": recording_table,
    "knowing": knowing_table,
    "real": real_table,
}


def filled(text: str, figures: Mapping[str, Any], tables: Tables = TABLES) -> str:
    """The page with its tables anew.

    Raises
    ------
    ValueError
        When a table has no place.
    """
    return with_tables(text, {name: table(figures) for name, table in tables.items()})


def read(figures: Path = FIGURES) -> dict[str, Any]:
    """The figures that were measured."""
    found: dict[str, Any] = json.loads(figures.read_text(encoding="utf-8"))
    return found


def write(about: str | None, figures: Path, page: Path, tables: Tables, measure: Callable[[Path, int], Any]) -> None:
    """The command of a page: measure, unless ``--only-page`` is given, and write figures and tables."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "design", help="folder of the evaluations")
    parser.add_argument("--processes", type=int, default=2, help="evaluations at a time")
    parser.add_argument("--only-page", action="store_true", help="do not evaluate: write the tables from the figures that are there")
    given = parser.parse_args()
    if not given.only_page:
        write_atomically(figures, json.dumps(measure(given.work, given.processes)) + "\n")
    found = read(figures)
    write_atomically(page, filled(page.read_text(encoding="utf-8"), found, tables))
    for name, table in tables.items():
        sys.stdout.write(f"\n{name}\n{table(found)}\n")


if __name__ == "__main__":
    write(__doc__, FIGURES, PAGE, TABLES, measure)
