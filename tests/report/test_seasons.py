"""Runs that start on different days, in weather of their own: what the page draws and dates of them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from glbench.evaluation.profiles import load_profile
from glbench.leaderboard import collect_results, rank
from glbench.leaderboard.collect import published_expectations
from glbench.report import build_report
from glbench.resources import data_folder
from tests.report.conftest import Made
from tests.report.test_data import blocks_of, embedded, unpacked

REAL, PAPER = "GreenhouseReal-v1", "Schiphol2010-Delta10-v1"
SHOWN = {REAL: ("mpc_greenhouse", "rule_based"), PAPER: ("rule_based",)}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Released results with their profiles: two agents whose worst runs differ, and one of a task with a single season."""
    folder: Path = tmp_path_factory.mktemp("seasons")
    for task, agents in SHOWN.items():
        (folder / "results" / task).mkdir(parents=True)
        for agent in agents:
            for file in (data_folder("reports/released/results") / task).glob(f"{agent}.*"):
                shutil.copy(file, folder / "results" / task)
    stored = collect_results([folder / "results"])
    report = build_report(stored)
    (folder / "index.html").write_text(report.html, encoding="utf-8")
    return Made(folder, stored, rank(stored, published_expectations()), report, folder / "index.html")


def blocks_by_agent(made: Made, task: str) -> dict:
    """The profiles of the page by agent."""
    blocks = blocks_of(made.report.html)
    return {one["agent"]: json.loads(blocks[one["profile"]]) for one in embedded(made)["results"] if one["task"].endswith(task)}


def test_each_worst_run_has_the_weather_of_its_own_season(made):
    profiles = blocks_by_agent(made, REAL)
    assert len({profile["seeds"]["worst"] for profile in profiles.values()}) == 2
    for item in made.stored:
        if item.result.task.id.endswith(REAL):
            genuine = load_profile(item.result, item.path).document["weather"]["hours"]["outdoor_temperature"]
            packed = profiles[item.result.agent.name]["outside"]["outdoor_temperature"]
            kept = np.array(genuine["values"]) * genuine["resolution"]
            np.testing.assert_allclose(unpacked(packed), kept, rtol=0.0, atol=0.5001 * packed["resolution"])
