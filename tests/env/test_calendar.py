"""Seasons over the end of a year: the day of the year is that of the calendar."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glbench.agents import PrivilegedController, load_agent
from glbench.env import GreenhouseEnv, Simulation
from glbench.tasks import TaskSpec, get_task, list_tasks, task_card
from tests.env.stepping import StillKernel

MakeTask = Callable[..., TaskSpec]


def over_new_year(make_task: MakeTask, start: str, days: int) -> TaskSpec:
    return make_task(("start = 2010-03-01", f"start = {start}"), days=days)


@pytest.mark.parametrize(("start", "last"), [("2009-12-31", 364), ("2008-12-31", 365)])  # 2008 is a leap year
def test_info_tells_the_calendar_day(make_task: MakeTask, start: str, last: int) -> None:
    environment = GreenhouseEnv(over_new_year(make_task, start, 2), kernel=StillKernel())
    _, info = environment.reset(seed=1)
    days = [info["day_of_year"]] + [environment.step(np.zeros(6))[4]["day_of_year"] for _ in range(192)]
    assert days[0] == last
    assert days[95] == last + 95 / 96
    assert (days[96], days[192]) == (0.0, 1.0)


def test_the_privileged_controller_goes_on_lighting_after_2_january(make_task: MakeTask) -> None:
    """Its lamps may burn all year, which it takes for the days -1 to 366."""
    task = over_new_year(make_task, "2009-12-28", 10)
    simulation = Simulation(task, 1, StillKernel())
    controller = load_agent("rule_based").make(task_card(task))
    assert isinstance(controller, PrivilegedController)
    controller.reset(task_card(task), 1)
    simulation.reset([1])
    lamps = task.actuation.controls.index("uLamp")
    lit = np.zeros(10)
    for step in range(task.steps):
        now = simulation.hour_of_day, simulation.day_of_year
        lit[step // 96] += controller.controls(simulation.x, simulation.d, *now)[0, lamps]
        simulation.step_controls(np.zeros((1, 6)))
    assert lit[0] > 20  # quarters of an hour
    assert (lit > 20).all(), lit


def test_the_tasks_of_the_paper_lie_within_one_year() -> None:
    for task in (one for one in list_tasks() if "paper" in one.suites):
        weather = task.disturbances()
        seconds = 59 * 86400 + int(task.step_seconds) * np.arange(len(weather.times))
        assert (weather.day_of_year == seconds / 86400.0).all()


def test_one_calendar_is_shown_to_everybody(make_task: MakeTask) -> None:
    task = over_new_year(make_task, "2009-12-31", 2)
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    for _ in range(100):
        result = simulation.step(np.zeros((1, 6)))
    names = [column.name for column in task.observed()]
    shown = result.observations[0, [names.index("sin_day_of_year"), names.index("cos_day_of_year")]]
    angle = 2.0 * np.pi * simulation.day_of_year[0] / 365.0
    assert shown == pytest.approx([np.sin(angle), np.cos(angle)], abs=1e-6)
    assert simulation.day_of_year[0] == pytest.approx(4 / 96)
    assert get_task("Schiphol2010-Delta10-v1").disturbances().day_of_year[0] == 59.0
