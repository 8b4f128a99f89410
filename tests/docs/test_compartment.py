"""docs/compartment.md: its task and its example, as they stand there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from glbench.env import GreenhouseEnv, Simulation
from glbench.model import COMPARTMENT
from glbench.tasks import TaskSpec, get_task

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "compartment.md").read_text(encoding="utf-8")


@pytest.fixture
def task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TaskSpec:
    """The task of the page, in the working directory."""
    monkeypatch.chdir(tmp_path)
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    Path("compartment.toml").write_text(text, encoding="utf-8")
    return get_task("compartment.toml")


def test_a_task_of_ones_own_has_a_compartment_that_steps(task: TaskSpec) -> None:
    assert task.model_value is COMPARTMENT
    p = dict(zip(COMPARTMENT.parameter_names, task.parameters().tolist(), strict=True))
    assert (p["hecAirMass"], p["tWall"], p["laiTop"]) == (4.0, 19.0, 1.0)
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(example, "docs/compartment.md", "exec", dont_inherit=True), names)
    assert np.isfinite(names["reward"])  # type: ignore[call-overload]
    assert names["terminated"] is False


@pytest.mark.filterwarnings("ignore")
def test_gymnasium_finds_nothing_wrong_with_its_environment(task: TaskSpec) -> None:
    check_env(GreenhouseEnv(task), skip_render_check=True)


def test_a_mass_takes_heat_of_the_day_into_the_night(task: TaskSpec) -> None:
    """Against the same task without a mass, with everything shut and off: the air is cooler by day and warmer by night."""
    air = [column.name for column in task.observed()].index("air_temperature")
    bare = task.replace(
        {"model.overrides": {"hecAirMass": {"value": 0.0, "unit": "W m-2 K-1"}, "etaGlobMass": {"value": 0.0, "unit": "-"}}}
    )
    courses = []
    for one in (task, bare):
        simulation = Simulation(one, 1)
        simulation.reset([1])
        course = []
        for _ in range(2 * 96):
            result = simulation.step(np.zeros((1, len(one.actions))))
            course.append(result.observations[0, air])
        courses.append(np.array(course))
    difference = courses[0] - courses[1]
    assert difference.min() < -0.2
    assert difference.max() > 0.2
    assert np.ptp(courses[0]) < np.ptp(courses[1])
