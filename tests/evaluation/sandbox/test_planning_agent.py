"""The agent of docs/control.md plans inside the sandbox."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from glbench.agents.baselines import read_baseline
from glbench.agents.predictive import PredictiveSettings
from glbench.control import Climatology
from glbench.evaluation import TimeLimits, prepare
from glbench.kernel import available
from glbench.tasks import get_task
from tests.support import examples_of


@pytest.mark.skipif("compiled" not in available(), reason="no compiled kernel here")
@pytest.mark.parametrize(("task_id", "baseline"), [("Spring-v1", "mpc"), ("WinterLED-v1", "mpc_energy")])  # without lamps and with them
def test_the_agent_of_the_page_plans_inside(task_id: str, baseline: str, needs_sandbox: None, tmp_path: Path) -> None:
    task = get_task(task_id).replace({"id": "my/OneDay-v1", "weather.days": 1, "weather.step_seconds": 1800})
    (agent,) = (example for example in examples_of("control.md") if "make_agent" in example)
    settings = read_baseline(baseline).settings
    assert isinstance(settings, PredictiveSettings)
    folder = tmp_path / "planner"
    folder.mkdir()
    (folder / "agent.py").write_text(agent, encoding="utf-8")
    (folder / "end_value.json").write_text(json.dumps(settings.end_values[task.model_id]), encoding="utf-8")
    Climatology.of(task).write(folder / "climatology.json")
    evaluation = prepare(task, folder, runs=2, out=None, sandbox="bubblewrap", limits=TimeLimits(start=300.0, step=60.0))
    result = evaluation.run()
    assert result.summary.ok == 2, result.runs[0].reason
