"""Results for the page: two agents evaluated on two small tasks, and released results of three tasks of the paper."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from glbench.evaluation import evaluate
from glbench.leaderboard import StoredResult, TaskTable, collect_results, rank
from glbench.leaderboard.collect import published_expectations
from glbench.report import Report, build_report
from glbench.resources import data_folder

PAPER = ("Schiphol2010-Delta00-v1", "Schiphol2010-Delta10-v1", "Schiphol2010-Delta30-v1")
RELEASED = ("rule_based", "rule_based_fair")
AGENTS = {
    "thrifty": "return np.tile([0.004, 0.002, 0.02, 0.01, 0.0, 0.0], (self.n, 1))",
    "lavish": "return np.tile([0.03, 0.03, 0.0, 0.0, 0.05, 0.0], (self.n, 1))",
    "doomed": "self.left -= 1; return np.full((self.n, 6), 0.01 if self.left > 0 else np.nan)",
}
"""The third fails in all runs."""
OTHER_PRICES = {"revenue": 2.4, "cost_heat": 0.05, "cost_electricity": 0.02, "cost_co2": 0.1}


@dataclass(frozen=True)
class Made:
    """Stored results, the page made of them, and the file that holds it."""

    folder: Path
    stored: tuple[StoredResult, ...]
    tables: tuple[TaskTable, ...]
    report: Report
    file: Path


def small_task(folder: Path, name: str, prices: dict[str, float] | None = None) -> Path:
    """The default task, cut to two days of hourly steps and three runs, with a crop that is known."""
    text = (data_folder("tasks") / "schiphol2010-delta10-v1.toml").read_text(encoding="utf-8")
    replaced = {
        'id = "glbench/Schiphol2010-Delta10-v1"': f'id = "test/{name}-v1"',
        'suites = ["paper"]': "suites = []",
        "days = 60": "days = 2",
        "step_seconds = 900": "step_seconds = 3600",
        "delta = 0.10": "delta = 0.0",
        "runs = 30": "runs = 3",
    }
    if prices is not None:
        replaced |= {
            "fruit = { value = 1.6": f"fruit = {{ value = {prices['revenue']}",
            "co2 = { value = 0.3": f"co2 = {{ value = {prices['cost_co2']}",
            "heat = { value = 0.09": f"heat = {{ value = {prices['cost_heat']}",
            "electricity = { value = 0.3": f"electricity = {{ value = {prices['cost_electricity']}",
        }
    for old, new in replaced.items():
        assert old in text, old
        text = text.replace(old, new, 1)
    path = folder / f"{name.lower()}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def write_agent(folder: Path, name: str) -> Path:
    path = folder / f"{name}.py"
    path.write_text(
        "import numpy as np\n"
        "class Agent:\n"
        "    def reset(self, task, n_runs):\n        self.n, self.left = n_runs, 20\n"
        f"    def act(self, observations):\n        {AGENTS[name]}\n"
        "def make_agent(task):\n    return Agent()\n",
        encoding="utf-8",
    )
    return path


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("report")
    results = folder / "results"
    for name in PAPER:
        (results / name).mkdir(parents=True)
        for agent in RELEASED:
            for file in (data_folder("reports/released/results") / name).glob(f"{agent}.*json"):
                shutil.copy(file, results / name)
    tasks = [small_task(folder, "Days"), small_task(folder, "CheapDays", OTHER_PRICES)]
    for task in tasks:
        for name in AGENTS:
            evaluate(task, write_agent(folder, name), out=folder)
    stored = collect_results([results])
    report = build_report(stored)
    file = folder / "index.html"
    file.write_text(report.html, encoding="utf-8")
    return Made(folder, stored, rank(stored, published_expectations()), report, file)
