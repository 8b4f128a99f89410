"""The suite transfer: agents of Spring-v1, unchanged, in other climates and other houses."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from glbench.env import GreenhouseEnv
from glbench.env.scenario import RunScenarios, run_weather
from glbench.errors import TaskError
from glbench.evaluation import evaluate
from glbench.tasks import TaskSpec, get_task, list_tasks, task_card
from glbench.training import make_vec_env
from tests.evaluation.agent_files import AgentWriter, agent_writer

BASE = "glbench/Spring-v1"
TRANSFER = [task.id for task in list_tasks() if "transfer" in task.suites]
CLIMATES = {"Greensboro": "greensboro", "SandPoint": "sand_point", "Miami": "miami"}
HOUSES = {"HPS2021": "hps_2021", "LED2021": "led_2021"}

FORECASTER = """
    def reset(self, task, n_runs):
        self.seen = task.observation_names.index("outdoor_temperature_in_6h")
        self.controls = len(task.actions)

    def act(self, observations):
        return np.tile(np.tanh(10.0 - observations[:, self.seen, None]), (1, self.controls))
"""
"""An agent that heats and opens everything where it will be cold: it reads what Spring-v1 shows and no other task before."""


@pytest.fixture
def write_agent(tmp_path: Path) -> AgentWriter:
    return agent_writer(tmp_path)


def test_the_suite_is_three_climates_and_two_houses() -> None:
    names = [*(f"glbench/Transfer-{place}-v1" for place in CLIMATES), *(f"glbench/Transfer-House-{one}-v1" for one in HOUSES)]
    assert sorted(TRANSFER) == sorted(names)
    assert [get_task(f"Transfer-{place}-v1").weather.source for place in CLIMATES] == list(CLIMATES.values())
    assert [get_task(f"Transfer-House-{one}-v1").model.parameters for one in HOUSES] == list(HOUSES.values())


@pytest.mark.parametrize("name", TRANSFER)
def test_a_task_shows_and_takes_what_its_base_does(name: str) -> None:
    task, base = get_task(name), get_task(BASE)
    assert task.base == BASE
    assert [(q.name, q.unit) for q in task.observed()] == [(q.name, q.unit) for q in base.observed()]
    ours, theirs = task_card(task), task_card(base)
    assert (ours.actions, ours.actuation, ours.steps, ours.constraints) == (
        theirs.actions, theirs.actuation, theirs.steps, theirs.constraints,
    )  # fmt: skip
    keys = {change.key for change in task.changes}
    assert keys <= {
        "weather.source", "weather.start", "model.parameters", "splits.training", "splits.validation", "splits.test.years",
        "splits.test.seasons", "evaluation.runs",
    }  # fmt: skip


@pytest.mark.parametrize("name", TRANSFER)
def test_a_task_has_a_test_alone(name: str) -> None:
    task = get_task(name)
    assert task.splits is not None
    assert (task.split, task.splits.names, task.splits.test.seasons, task.evaluation.runs) == ("test", ("test",), 30, 30)
    with pytest.raises(TaskError, match=r"has no training split.* Train on glbench/Spring-v1, its base,"):
        make_vec_env(name)


@pytest.mark.parametrize("name", TRANSFER)
def test_an_environment_shows_seasons_that_are_not_scored(name: str) -> None:
    task = gymnasium.make(name).unwrapped.task  # type: ignore[attr-defined]
    scored = get_task(name).scored
    assert (task.id, task.digest, task.split) == (name, scored.digest, "preview")
    assert task.season_years == ((2008, 2009, 2010) if "House" in name else (2001,)), "houses: no year that Spring tests in"
    for seed in (10000, 10001):
        shown, held_out = run_weather(task, seed).values[:, 1], run_weather(scored, seed).values[:, 1]
        assert not np.array_equal(shown, held_out)
    draws = [RunScenarios(one).draw([10000]).parameters for one in (task, scored)]
    assert not np.array_equal(*draws), "another crop"


def test_real_years_that_score_are_not_previewed() -> None:
    task = get_task(BASE).replace(
        {
            "id": "test/Real2012-v1", "scenario.generated": None, "scenario.co2_range": None, "splits.training": None,
            "splits.validation": None, "splits.test": {"years": [2012], "seasons": None},
        }
    )  # fmt: skip
    assert GreenhouseEnv(task).task.season_years == (2008, 2009, 2010), "years in which agents of the base train"
    alone = TaskSpec.from_tables(task.as_tables())
    with pytest.raises(TaskError, match="no training split"):
        GreenhouseEnv(alone)
    with pytest.raises(TaskError, match="no split 'preview'"):
        alone.in_split("preview")
    assert GreenhouseEnv(alone, split="test").task.season_years == (2012,)


@pytest.mark.parametrize("name", TRANSFER)
def test_a_season_can_be_run(name: str) -> None:
    env = GreenhouseEnv(name, split="test", kernel="fast")
    observation, _ = env.reset(seed=10000)
    for _ in range(5):
        assert observation in env.observation_space
        observation, reward, terminated, _, _ = env.step(np.zeros(env.action_space.shape or (), np.float32))
        assert np.isfinite(reward)
        assert not terminated


def test_runs_share_crop_and_sensors_with_those_of_the_base_under_another_sky() -> None:
    base, there = (get_task(name).scored for name in (BASE, "Transfer-Miami-v1"))
    ours, theirs = (RunScenarios(task).draw(range(10000, 10003)) for task in (base, there))
    assert ours.parameters is not None
    assert theirs.parameters is not None
    assert np.array_equal(ours.parameters, theirs.parameters)
    assert np.array_equal(ours.traits, theirs.traits)
    assert np.array_equal(ours.first, theirs.first), "and the day of the start"
    assert run_weather(there, 10000).values[:, 1].mean() > run_weather(base, 10000).values[:, 1].mean() + 10.0


def test_houses_stand_in_the_seasons_of_the_base() -> None:
    base, there = (get_task(name).scored for name in (BASE, "Transfer-House-LED2021-v1"))
    for seed in (10000, 10029):
        assert np.array_equal(run_weather(base, seed).values, run_weather(there, seed).values)
    drawn = [base.model_value.parameter_names.index(name) for name in base.uncertain_parameters()]
    ours, theirs = (np.asarray(RunScenarios(task).draw([10000]).parameters)[0, drawn] / task.parameters()[drawn] for task in (base, there))
    assert np.allclose(ours, theirs, rtol=1e-12), "crop and house deviate by the same shares"
    assert not np.array_equal(base.parameters(), there.parameters())


@pytest.mark.parametrize("name", ["Transfer-Miami-v1", "Transfer-House-LED2021-v1"])
def test_an_agent_of_the_base_is_evaluated_unchanged(name: str, write_agent: AgentWriter) -> None:
    agent, days = write_agent(FORECASTER), {"weather.days": 1}
    at_home, away = (evaluate(get_task(task).replace(days), agent, runs=2) for task in (BASE, name))
    assert {run.status for run in (*at_home.runs, *away.runs)} == {"ok"}
    assert [run.metrics["reward"] for run in at_home.runs] != [run.metrics["reward"] for run in away.runs]
