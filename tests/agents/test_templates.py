"""``glbench submit new``: every template runs, and nothing is overwritten."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import action_problems, load_agent, read_card
from glbench.agents.loading import KINDS, Kind, new_submission
from glbench.env import Simulation
from glbench.errors import SubmissionError
from glbench.tasks import DEFAULT_TASK, TaskCard, get_task, task_card


@pytest.mark.parametrize("kind", KINDS)
def test_a_template_bears_the_name_of_its_folder(tmp_path: Path, kind: Kind) -> None:
    files = new_submission(tmp_path / "anna", kind)
    assert read_card(tmp_path / "anna" / "submission.toml").name == "anna"
    assert {"submission.toml", "README.md"} < {file.name for file in files}
    assert not any("template-name" in file.read_text(encoding="utf-8") for file in files)


def test_templates_that_are_trained_name_the_default_task(tmp_path: Path) -> None:
    written = [*new_submission(tmp_path / "anna", "sb3"), *new_submission(tmp_path / "bert", "torch")]
    named = [task for file in written for task in re.findall(r"glbench/\w+-v\d+", file.read_text(encoding="utf-8"))]
    assert named == [DEFAULT_TASK] * 3


@pytest.mark.parametrize("task_id", ["Schiphol2010-Delta10-v1", "Spring-v1", "GreenhouseReal-v1"])
@pytest.mark.parametrize("kind", ["rule", "mpc", "torch"])
def test_a_template_with_code_runs_at_once_and_decides_every_run_by_itself(tmp_path: Path, task_id: str, kind: Kind) -> None:
    card = task_card(get_task(task_id))
    if kind == "torch" and importlib.util.find_spec("torch") is None:
        pytest.skip("torch is not installed")
    new_submission(tmp_path / "anna", kind)
    loaded = load_agent(tmp_path / "anna")
    together, alone = loaded.make(card), loaded.make(card)
    together.reset(card, 3)
    alone.reset(card, 1)
    simulation = Simulation(get_task(card.id), 3)
    observations = simulation.reset([1, 2, 3])
    for _ in range(40):
        actions = together.act(observations)  # type: ignore[union-attr]
        assert action_problems(actions, card, 3) == {}
        assert (alone.act(observations[1:2]) == actions[1:2]).all()  # type: ignore[union-attr]
        observations = simulation.step(actions).observations


def test_the_plans_of_the_mpc_template_earn_more_than_doing_nothing(tmp_path: Path, card: TaskCard) -> None:
    new_submission(tmp_path / "anna", "mpc")
    agent = load_agent(tmp_path / "anna").make(card)
    agent.reset(card, 1)
    earned = {}
    for name in ("plans", "nothing"):
        simulation = Simulation(get_task(card.id), 1)
        observations, total = simulation.reset([1]), 0.0
        for _ in range(192):
            actions = agent.act(observations) if name == "plans" else np.zeros((1, 6))  # type: ignore[union-attr]
            outcome = simulation.step(actions)
            observations, total = outcome.observations, total + float(outcome.rewards[0])
        earned[name] = total
    assert earned["plans"] > earned["nothing"]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "anna").mkdir()
    with pytest.raises(SubmissionError, match="is there already, and nothing is overwritten"):
        new_submission(tmp_path / "anna", "rule")
    assert list((tmp_path / "anna").iterdir()) == []


def test_a_name_that_no_agent_can_have_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(SubmissionError, match="is the name of a baseline"):
        new_submission(tmp_path / "rule_based", "rule")
    assert list(tmp_path.iterdir()) == []
