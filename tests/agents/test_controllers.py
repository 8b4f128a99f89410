"""Built-in controllers are declared where they are written, and found by their name."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from glbench.agents.baselines import read_baseline
from glbench.agents.controllers import CLOCK, CONTROLLERS, MODULES, ObservedController, controller, find_controller
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks import TaskCard, get_task, task_card


class Opener(ObservedController):
    """Opens the vents where it is warm."""

    title = "the opener"

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Begin."""
        self.begin(task, n_runs, ("air_temperature", *CLOCK), optional=("wind_speed", "no_such_column"))

    def decide(self, readings: dict[str, np.ndarray], positions: dict[str, np.ndarray], /) -> np.ndarray:
        """Vents 1 above 20 degC."""
        controls = {name: np.zeros(self.runs) for name in self.task.action_names}
        controls["uVent"] = np.where(readings["air_temperature"] > 20.0, 1.0, 0.0)
        self.readings, self.positions = readings, positions
        return self.towards(controls, positions)


@pytest.mark.parametrize("name", MODULES)
def test_a_controller_is_in_the_module_that_is_named_for_it(name: str) -> None:
    make = find_controller(name).make
    assert make.__module__ == f"glbench.agents.{MODULES[name]}"


def test_a_folder_of_settings_can_name_a_controller_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    card = 'title = "t"\ncontroller = "opener"\nsettings = "page.txt"\ndescription = "d"\nmade = "m"\nsources = []\n'
    (tmp_path / "card.toml").write_text(card, encoding="utf-8")
    (tmp_path / "page.txt").write_text("20", encoding="utf-8")
    with pytest.raises(SubmissionError, match="there is no controller 'opener'"):
        read_baseline(tmp_path)
    monkeypatch.setitem(CONTROLLERS, "opener", find_controller("grower"))  # removed at the end, also when the test fails
    controller("opener", read=Path.read_text, version="1")(lambda _settings: Opener())
    baseline = read_baseline(tmp_path)
    assert (baseline.sees, baseline.privileged, baseline.settings) == ("observations", False, "20")
    assert isinstance(baseline.make(task_card(get_task("Spring-v1"))), Opener)


def test_readings_and_positions_come_by_name_and_changes_are_limited() -> None:
    card, agent = task_card(get_task("Spring-v1")), Opener()
    agent.reset(card, 3)
    columns = {name: index for index, name in enumerate(card.observation_names)}
    observations = np.zeros((3, len(columns)), np.float32)
    observations[:, columns["air_temperature"]] = 18.0, 25.0, 25.0
    observations[2, columns["vents"]] = next(one.at_one for one in card.controls if one.name == "uVent")
    actions = agent.act(observations)
    vents = card.action_names.index("uVent")
    assert actions[:, vents].tolist() == [0.0, 1.0, 0.0]
    assert agent.positions["uVent"].tolist() == [0.0, 0.0, 1.0]
    assert set(agent.readings) == {"air_temperature", "wind_speed", *CLOCK}


def test_what_a_task_lacks_is_refused_in_words() -> None:
    card, agent = task_card(get_task("Spring-v1")), Opener()
    with pytest.raises(SubmissionError, match="does not show the observations air_temperature, without which the opener"):
        agent.reset(dataclasses.replace(card, observations=card.observations[1:]), 1)
    with pytest.raises(SubmissionError, match=r"the opener can act through 'rate' or 'set_point' only\. The baseline 'grower'"):
        agent.reset(task_card(get_task("SpringSetpoints-v1")), 1)
    agent.reset(card, 2)
    with pytest.raises(ShapeError, match="act got observations of 3 runs, reset was called with 2"):
        agent.act(np.zeros((3, len(card.observations)), np.float32))
