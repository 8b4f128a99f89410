"""A tomato, a lettuce and a toy of two states go through all rooms side by side, in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glbench.episodes import read_episode
from glbench.episodes.rerun_recording import shown_of
from glbench.evaluation import evaluate, result_path
from glbench.kernel import Kernel
from glbench.leaderboard.collect import collect_results
from glbench.model import LETTUCE, TOMATO, paper, register_model
from glbench.report.page import build_report
from glbench.tasks import TaskSpec, get_task
from glbench.verification import verify
from tests.support import lettuce_task
from tests.tasks.toy import TASK, Toy

AGENT = """
import numpy as np

class Idle:
    def __init__(self, card):
        self.size = len(card.actions)

    def reset(self, task, n_runs):
        pass

    def act(self, observations):
        return np.zeros((len(observations), self.size))

def make_agent(task):
    return Idle(task)
"""


@pytest.fixture
def three(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[TaskSpec, ...]:
    monkeypatch.setattr(paper, "_MODELS", dict(paper._MODELS))
    register_model(Toy())
    # The toy's state is called water, too: the amount gets a name of its own.
    toy = TASK.replace('flow = "water"', 'flow = "water"\namount = "water_used"\nunit = "kg m-2"')
    (tmp_path / "toy.toml").write_text(toy, encoding="utf-8")
    short = 'base = "glbench/Schiphol2010-Delta10-v1"\nid = "mylab/Short-v1"\ntitle = "Two days"\nweather.days = 2\nevaluation.runs = 2\n'
    (tmp_path / "tomato.toml").write_text(short, encoding="utf-8")
    return get_task(tmp_path / "tomato.toml"), lettuce_task(), get_task(tmp_path / "toy.toml")


def test_three_models_are_stepped_evaluated_recorded_reproduced_ranked_and_shown(three: tuple[TaskSpec, ...], tmp_path: Path) -> None:
    agent, out = tmp_path / "idle.py", tmp_path / "out"
    agent.write_text(AGENT, encoding="utf-8")
    models = [task.model_value for task in three]
    assert models == [TOMATO, LETTUCE, Toy()]
    kernels = [Kernel(model, task.step_seconds) for model, task in zip(models, three, strict=True)]
    for task, kernel in zip(three, kernels, strict=True):
        x, u, d = task.initial_state(), np.zeros(len(task.model_value.controls)), task.disturbances().values[0]
        assert np.isfinite(kernel.step(x, u, d, task.parameters())).all()

    for task in three:
        result = evaluate(task, agent, out=out, sandbox="none", episodes="best")
        path = result_path(out, task.id, "idle")
        assert result.failed == ()
        assert verify(path).exactness == "bits"
        recorded = next((out / "episodes").rglob(f"*{task.short_id}*/**/seed-*.mcap"))
        episode = read_episode(recorded)
        assert episode.states.shape[1] == len(task.model_value.states)
        assert {quantity.name for quantity in task.quantities} <= set(episode.names)
        assert shown_of([episode]).signals.curves

    stored = collect_results([out / "results"])
    report = build_report(stored)
    assert {one.result.task.id for one in stored} == {task.id for task in three}
    assert (report.results, report.without_profile) == (3, ())
    assert all(task.short_id in repr(report.data) for task in three)
