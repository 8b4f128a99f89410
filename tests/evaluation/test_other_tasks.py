"""A task of schema 2: another model, a ledger of its own, and for each run its own year, first day and plants."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import LoadedAgent
from glbench.env import Simulation
from glbench.errors import SubmissionError
from glbench.evaluation import Progress, evaluate, load_result, result_path
from glbench.evaluation.metrics import units_of
from glbench.evaluation.profiles import load_profile, make_profile
from glbench.evaluation.profiles.record import unpack
from glbench.evaluation.saving import recorded_actions, task_of_result
from glbench.tasks import TaskCard, TaskSpec
from tests.evaluation.agent_files import AgentWriter
from tests.support import lettuce_task

Floats = NDArray[np.float64]


class StopError(Exception):
    """Stands for Ctrl-C."""


def stop(standing: Progress) -> None:
    if standing.step == 17 and not standing.replaying:
        raise StopError


class Warm:
    """A privileged controller that heats where it is cold outside or the lettuce small, by the clock of each run; it writes down all."""

    privileged = True

    def __init__(self) -> None:
        self.seen: list[tuple[Floats, Floats, Floats, Floats]] = []

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        self.seen = []

    def controls(self, x: Floats, d: Floats, hour: Floats, day: Floats, /) -> Floats:
        self.seen.append((x, d, hour, day))
        u = np.zeros((len(x), 6))
        u[:, 0] = np.clip((20.0 - d[:, 1]) / 40.0 + x[:, 21] + hour / 100.0 + day / 1000.0, 0.0, 1.0)
        return u


def privileged(controller: Warm) -> LoadedAgent:
    return LoadedAgent("warm", "baseline", "0" * 64, "state", "privileged: everything", lambda card: controller)


@pytest.fixture
def lettuce() -> TaskSpec:
    return lettuce_task()


def test_the_number_of_workers_and_an_interruption_change_no_bit(lettuce: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent()
    alone = evaluate(lettuce, agent)
    shared = evaluate(lettuce, agent, workers=2, out=tmp_path / "shared")
    with pytest.raises(StopError):
        evaluate(lettuce, agent, out=tmp_path / "late", checkpoint_seconds=0.0, progress=stop)
    late = evaluate(lettuce, agent, out=tmp_path / "late")

    assert late.evaluation.resumed_at_step == 17
    assert alone.results_digest == shared.results_digest == late.results_digest
    assert alone.units == units_of(lettuce)
    assert late.profile == shared.profile, "replayed in the one, traced in the other"
    assert alone.versions.model == "greenlight-lettuce-1.0.0"


def test_a_privileged_controller_sees_state_weather_and_clock_of_each_run(lettuce: TaskSpec, tmp_path: Path) -> None:
    controller = Warm()
    result = evaluate(lettuce, privileged(controller), out=tmp_path / "whole")
    simulation = Simulation(lettuce, 3)
    simulation.reset(lettuce.evaluation.seeds)
    x, d, hour, day = controller.seen[0]

    assert result.failed == ()
    assert x.shape == (3, len(lettuce.model_value.states))
    for shown, there in ((x, simulation.x), (d, simulation.d), (hour, simulation.hour_of_day), (day, simulation.day_of_year)):
        assert shown.tolist() == there.tolist()
    assert len(set(day.tolist())) > 1, "the runs start on different days"

    with pytest.raises(StopError):
        evaluate(lettuce, privileged(Warm()), out=tmp_path / "late", checkpoint_seconds=0.0, progress=stop)
    late = evaluate(lettuce, privileged(Warm()), out=tmp_path / "late")
    assert late.evaluation.resumed_at_step == 17
    assert late.results_digest == result.results_digest


def test_a_controller_of_another_model_says_so(lettuce: TaskSpec) -> None:
    with pytest.raises(SubmissionError, match=r"reads the state of greenlight-tomato-1\.0\.0, and test/Salad-v1 has greenlight-lettuce"):
        evaluate(lettuce, "rule_based")


def test_doing_nothing_and_the_fair_rules_need_no_tomato(lettuce: TaskSpec) -> None:
    for agent in (Path("submissions/do_nothing.py"), "rule_based_fair"):
        assert evaluate(lettuce, agent, runs=1).failed == ()


def test_a_profile_shows_the_season_of_each_run(lettuce: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    result = evaluate(lettuce, write_agent(), out=tmp_path)
    path = result_path(tmp_path, lettuce.id, result.agent.name)
    profile = load_profile(load_result(path), path)
    assert profile is not None
    document, simulation = profile.document, Simulation(lettuce, 3)
    simulation.reset(result.evaluation.seeds)
    seeds = document["seeds"]
    worst = seeds["all"].index(seeds["worst"])
    sun = unpack(document["weather"]["hours"]["global_radiation"])
    step = int(np.argmax(sun))
    # Midnight of the greenhouse is 23 h of the day before in UTC.
    starts = [str(time)[:10] for time in simulation.time + np.timedelta64(1, "h")]
    for _ in range(step):
        simulation.step(np.zeros((3, 6)))

    assert seeds["starts"] == starts
    assert len(set(starts)) > 1
    assert sun[step] == pytest.approx(simulation.d[worst, 0], rel=1e-2)
    assert seeds["worst"] == min(result.runs, key=lambda run: run.metrics["epi"]).seed, "the task ranks by its profit"
    assert {"heads_gained", "heat", "epi", "pipe_temperature"} <= set(document["columns"])
    assert "fruit_fresh" not in document["columns"]

    log = recorded_actions(result, path)
    assert make_profile(task_of_result(result, path), result, log, None).digest == profile.digest
