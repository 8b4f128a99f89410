"""The light of the lamps: from its equation and one table of a ledger to info, results, viewer, board and report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glbench.env.info import info_quantities
from glbench.episodes.signals import signals_of
from glbench.evaluation import evaluate, load_result
from glbench.evaluation.profiles import load_profile
from glbench.leaderboard import collect_results, rank
from glbench.leaderboard.catalogue import catalogue, charts_of
from glbench.leaderboard.tables import to_json, to_markdown
from glbench.tasks import get_task
from tests.support import LETTUCE

LEDGER = """
[ledger.cost_lamp_light]
side = "paid"
flow = "lamp_light"
price = { value = 0.0, unit = "EUR mol-1" }  # counted, not paid for
"""
AGENT = """
import numpy as np

class Agent:
    def reset(self, task, n_runs):
        self.runs = n_runs

    def act(self, observations):
        return np.tile([0.0, 0.0, 0.0, 0.0, 1.0, 0.0], (self.runs, 1))

def make_agent(task):
    return Agent()
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A task that counts the light, an agent that switches the lamps on, and its result."""
    folder = tmp_path_factory.mktemp("light")
    (folder / "task.toml").write_text(LETTUCE.replace("[price_tables", f"{LEDGER}\n[price_tables", 1), encoding="utf-8")
    (folder / "lamps.py").write_text(AGENT, encoding="utf-8")
    evaluate(folder / "task.toml", folder / "lamps.py", out=folder)
    return folder


def test_light_of_the_lamps_is_shown_everywhere(folder: Path) -> None:
    task = get_task(folder / "task.toml")
    p = task.parameters_by_name()
    full = p["etaLampPar"] * p["zetaLampPar"] * p["thetaLampMax"] * 3600.0 * 1e-6  # mol m-2 in an hour
    (path,) = (folder / "results").rglob("lamps.json")
    result = load_result(path)
    on = np.minimum(0.1 * np.arange(1, task.steps + 1), 1.0)

    assert result.units["lamp_light"] == "mol m-2"
    assert result.values("lamp_light") == pytest.approx([full * on.sum()] * 3)
    assert result.values("cost_lamp_light") == pytest.approx([0.0] * 3)

    assert ("lamp_light", "mol m-2", "photons of PAR from the lamps") in [
        (one.name, one.unit, one.meaning) for one in info_quantities(task)
    ]
    signals = signals_of(task)
    (curve,) = (one for one in signals.curves if one.path == "energy/lamp_light")
    assert (curve.title, curve.unit, curve.form) == ("Light of the lamps, summed", "mol m⁻²", "sum")
    assert ("Light of the lamps", "used") in [(line.title, line.kind) for line in signals.accounts]

    profile = load_profile(result, path)
    assert profile is not None
    assert "lamp_light" in profile.document["day"]["columns"]
    assert charts_of(task).series["lamp_light"]["unit"] == "mol/m² an hour"
    assert "lamp_light" in charts_of(task).charts["season"]
    (item,) = (one for one in catalogue(task).items if one.column == "lamp_light")
    assert (item.label, item.short, item.unit, item.colour) == ("Light of the lamps", "light", "EUR/mol", 4)

    tables = rank(collect_results([folder / "results"]), {})
    assert "Lamp light [mol/m²]" in to_markdown(tables, {})
    board = json.loads(to_json(tables))
    assert board["units"]["lamp_light"] == "mol m-2"
