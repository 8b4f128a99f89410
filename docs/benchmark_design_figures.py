"""Tables of docs/benchmark-design.md: ``python docs/benchmark_design_figures.py [--work runs/design] [--only-page]``.

Evaluates simple controllers on seasons made of the training years, drawn with keys that no split has, so that nothing here has seen a test:
with single factors alone and with all of them, blind recordings of each controller, and agents that know the draws. Writes
docs/measurements/benchmark-design.json and the tables between the markers of the page. Evaluations that are there already in the work
folder are not done again.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.evaluation import evaluate
from glbench.evaluation.files import result_path
from glbench.evaluation.recordings import write_recording
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, get_task

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PAGE, FIGURES = DOCS / "benchmark-design.md", DOCS / "measurements" / "benchmark-design.json"

RUNS = 30
YEARS = [2008, 2009, 2010]
DRAWS, OTHER_DRAWS, RECORDED = "design", "design, drawn anew", "design, recorded"
"""Salts: of the scenarios, of others to show what knowing the first ones is worth under a secret salt, and of the recorded run."""

AGENTS = ("submissions/my_agent.py", "submissions/pi_controller.py", "submissions/constant_setpoints.py", "rule_based_fair", "rule_based_unlit", "rule_based", "submissions/do_nothing.py")  # fmt: skip
SETPOINT_AGENTS = ("grower",)
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
REFERENCE = "rule_based_unlit"
"""The controller whose score a lead is counted from; of set points, the worst of the sane ones."""

Scores = NDArray[np.float64]


def design(name: str, salt: str, without: Iterable[str] = (), **changes: Any) -> TaskSpec:
    """The task ``name`` with scenarios of the training years under a salt of their own."""
    return get_task(f"glbench/{name}-v1").replace(
        {
            "id": f"design/{name}-v1",
            "scenario.salt": salt,
            "splits": {"test": {"years": YEARS, "seasons": RUNS}},
            "evaluation.runs": RUNS,
            "without": list(without),
            **changes,
        }
    )


def with_factors(kept: Sequence[str]) -> TaskSpec:
    """Spring-v1 with some of its factors only; seasons are always unseen."""
    written = get_task("glbench/Spring-v1").written()
    groups = [group for group in written["scenario"]["parameters"] if group["name"] in kept]
    starts = [group for group in written["scenario"]["start"] if group["name"] in kept]
    without = [] if "sensors" in kept else ["sensors"]
    changes = {"scenario.parameters": groups, "scenario.start": starts}
    return design("Spring", DRAWS, without, **changes)


class Evaluations:
    """Scores of agents on tasks, from the work folder where they are there."""

    def __init__(self, work: Path) -> None:
        self.work = work

    def __call__(self, task: TaskSpec, agent: str, label: str) -> Scores:
        """Score of each run ``(runs,)``."""
        name = Path(agent).stem
        print(f"{label}: {name}", flush=True)
        result = evaluate(task, agent, workers=2, out=self.work / re.sub(r"\W+", "-", label))
        failed = [run.reason for run in result.runs if run.status != "ok"]
        if failed:
            raise SystemExit(f"{name} on {label}: {failed[0]}")
        return np.array([run.metrics[task.evaluation.metric] for run in result.runs])

    def recording(self, task: TaskSpec, agent: str, label: str) -> str:
        """Folder with a blind recording of the agent's first run."""
        name = Path(agent).stem
        folder = self.work / "recordings" / f"{task.short_id}-{name}" / f"recording_of_{name}"
        if not folder.is_dir():
            where = self.work / re.sub(r"\W+", "-", label)
            evaluate(task, agent, workers=2, out=where)
            write_recording(result_path(where, task.id, name), task.evaluation.first_seed, folder)
        return str(folder)


def factors(scores: Evaluations) -> dict[str, Any]:
    """What each factor alone costs each agent on Spring-v1, against unseen seasons alone."""
    found: dict[str, dict[str, list[float]]] = {}
    for factor, kept in FACTORS.items():
        task = with_factors(kept)
        for agent in AGENTS:
            found.setdefault(Path(agent).stem, {})[factor] = scores(task, agent, f"factors {factor}").tolist()
    return found


def family(scores: Evaluations, name: str) -> dict[str, Any]:
    """Scores of all agents, of recordings of those that act, and of the same agents under other draws."""
    agents = SETPOINT_AGENTS if name == "SpringSetpoints" else AGENTS
    task, anew, recorded = (design(name, salt) for salt in (DRAWS, OTHER_DRAWS, RECORDED))
    found: dict[str, Any] = {"scores": {}, "anew": {}, "recordings": {}}
    for agent in agents:
        stem = Path(agent).stem
        found["scores"][stem] = scores(task, agent, f"{name}").tolist()
        found["anew"][stem] = scores(anew, agent, f"{name} anew").tolist()
        if agent not in ("rule_based", "rule_based_unlit", "submissions/do_nothing.py"):  # these set controls, or act never
            folder = scores.recording(recorded, agent, f"{name} recorded")
            found["recordings"][stem] = scores(task, folder, name).tolist()
    return found


def spread(scores: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Standard deviations between agents, between scenarios, and of what is left (agent x scenario)."""
    table = np.array(list(scores.values()))
    agents, scenarios = table.mean(axis=1), table.mean(axis=0)
    rest = table - agents[:, None] - scenarios[None] + table.mean()
    return {
        "between agents": float(agents.std(ddof=1)),
        "between scenarios": float(scenarios.std(ddof=1)),
        "agent x scenario": float(np.sqrt((rest**2).sum() / ((len(agents) - 1) * (len(scenarios) - 1)))),
    }


def stability(scores: Mapping[str, Sequence[float]], draws: int = 4000) -> dict[str, float]:
    """Share of resampled sets of scenarios that give the same order of all agents, the same best, and mean share of pairs kept."""
    table = np.array(list(scores.values()))
    order = np.argsort(-table.mean(axis=1))
    generator = np.random.default_rng(2026)
    picked = generator.integers(0, table.shape[1], (draws, table.shape[1]))
    means = table[:, picked].mean(axis=2)  # (agents, draws)
    again = np.argsort(-means, axis=0)
    pairs = [(a, b) for a, b in combinations(range(len(table)), 2)]
    kept = [np.sign(means[a] - means[b]) == np.sign(table[a].mean() - table[b].mean()) for a, b in pairs]
    return {
        "same order": float((again == order[:, None]).all(axis=0).mean()),
        "same best": float((again[0] == order[0]).mean()),
        "pairs in the same order": float(np.mean(kept)),
    }


def knowing(found: Mapping[str, Any], sane: Sequence[str]) -> dict[str, float]:
    """What an agent gains that knows which of the sane controllers is best in each run, from scores under the public salt."""
    public, anew = (np.array([found[key][agent] for agent in sane]) for key in ("scores", "anew"))
    best = public.argmax(axis=0)
    runs = np.arange(public.shape[1])
    return {
        "public salt": float(public[best, runs].mean() - public.mean(axis=1).max()),
        "secret salt": float(anew[best, runs].mean() - anew.mean(axis=1).max()),
    }


def measure(work: Path) -> dict[str, Any]:
    """All figures."""
    scores = Evaluations(work)
    return {
        "runs": RUNS,
        "years": YEARS,
        "factors": factors(scores),
        "families": {name: family(scores, name) for name in FAMILIES},
    }


# The page.


def _number(value: float) -> str:
    return f"{value:+.2f}" if value else "0.00"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _sane(scores: Mapping[str, Sequence[float]]) -> dict[str, Sequence[float]]:
    return {agent: runs for agent, runs in scores.items() if agent != "do_nothing"}


def factor_table(figures: Mapping[str, Any]) -> str:
    """Mean score with seasons alone, and what each factor changes."""
    rows = []
    for agent, by_factor in figures["factors"].items():
        means = {factor: np.array(runs) for factor, runs in by_factor.items()}
        changes = [_number(float((means[factor] - means["seasons"]).mean())) for factor in FACTORS if factor != "seasons"]
        rows.append([f"`{agent}`", f"{means['seasons'].mean():.2f}", *changes, f"{means['all'].std(ddof=1):.2f}"])
    others = [factor for factor in FACTORS if factor not in ("seasons", "all")]
    return _table(["Agent", "Unseen seasons alone", *others, "all", "sd between runs, all"], rows)


def family_table(figures: Mapping[str, Any]) -> str:
    """Means of all agents on each family."""
    families = figures["families"]
    agents = dict.fromkeys(agent for found in families.values() for agent in found["scores"])
    rows = [
        [f"`{agent}`", *(f"{np.mean(found['scores'][agent]):.2f}" if agent in found["scores"] else "–" for found in families.values())]
        for agent in agents
    ]  # fmt: skip
    return _table(["Agent", *families], rows)


def spread_table(figures: Mapping[str, Any]) -> str:
    """Spread, and how stable the order is."""
    rows = []
    for name, found in figures["families"].items():
        sane = _sane(found["scores"])
        if len(sane) < 2:
            continue
        deviations, stable = spread(sane), stability(sane)
        rows.append([name, *(f"{value:.2f}" for value in deviations.values()), *(f"{100 * value:.0f} %" for value in stable.values())])
    return _table(["Family", "between agents", "between scenarios", "agent x scenario", "same order", "same best", "pairs in order"], rows)


def recording_table(figures: Mapping[str, Any]) -> str:
    """What a blind recording of each agent earns."""
    rows = []
    for name, found in figures["families"].items():
        for agent, runs in found["recordings"].items():
            own = np.array(found["scores"][agent])
            lost = own - np.array(runs)
            rows.append([name, f"`{agent}`", f"{own.mean():.2f}", f"{np.mean(runs):.2f}", f"{lost.mean():.2f}", f"{int((lost > 0).sum())} of {len(lost)}"])
    return _table(["Family", "Agent", "Score", "Its recording", "Lost", "Runs in which the recording is worse"], rows)


def knowing_table(figures: Mapping[str, Any]) -> str:
    """What knowing the draws is worth."""
    rows = []
    for name, found in figures["families"].items():
        sane = list(_sane(found["scores"]))
        if len(sane) > 1:
            gains = knowing(found, sane)
            rows.append([name, _number(gains["public salt"]), _number(gains["secret salt"])])
    return _table(["Family", "Public salt", "Secret salt"], rows)


TABLES: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "families": family_table,
    "factors": factor_table,
    "spread": spread_table,
    "recordings": recording_table,
    "knowing": knowing_table,
}


def page_with(figures: Mapping[str, Any], text: str) -> str:
    """The page with its tables anew."""
    for name, table in TABLES.items():
        pattern = rf"(<!-- table: {name} -->\n).*?(\n<!-- end -->)"
        if not re.search(pattern, text, flags=re.DOTALL):
            raise SystemExit(f"{PAGE} has no markers of the table '{name}'.")
        text = re.sub(pattern, lambda found, table=table: f"{found[1]}{table(figures)}{found[2]}", text, flags=re.DOTALL)
    return text


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "design", help="folder of the evaluations")
    parser.add_argument("--only-page", action="store_true", help="do not evaluate: write the tables from the figures that are there")
    given = parser.parse_args()
    if not given.only_page:
        figures = measure(given.work)
        write_atomically(FIGURES, json.dumps(figures, indent=1) + "\n")
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    write_atomically(PAGE, page_with(figures, PAGE.read_text(encoding="utf-8")))
    for name, table in TABLES.items():
        print(f"\n{name}\n{table(figures)}")


if __name__ == "__main__":
    main()
