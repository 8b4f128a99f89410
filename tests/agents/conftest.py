"""Fixtures of the agents' tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import RuleSettings, read_rule_settings
from glbench.resources import data_folder
from glbench.tasks import TaskCard, get_task, task_card

Observe = Callable[..., NDArray[np.float32]]


@pytest.fixture(scope="session")
def card() -> TaskCard:
    """Card of the benchmark's middle task."""
    return task_card(get_task("Schiphol2010-Delta10-v1"))


@pytest.fixture(scope="session")
def published() -> RuleSettings:
    """The published settings."""
    return read_rule_settings(data_folder("baselines") / "rule_based" / "rule_based.yml")


@pytest.fixture(scope="session")
def observe(card: TaskCard) -> Observe:
    """Function that makes observations: quantities by name, numbers or one value a run; the rest is a mild night."""
    night: dict[str, float | list[float]] = {
        "air_temperature": 18.0,
        "co2": 500.0,
        "relative_humidity": 75.0,
        "outdoor_temperature": 6.0,
        "outdoor_co2": 400.0,
    }

    def make(n: int, hour: float = 3.0, day: float = 59.0, **given: float | list[float]) -> NDArray[np.float32]:
        turn, year = 2 * np.pi * hour / 24, 2 * np.pi * day / 365
        clock = {"sin_hour_of_day": np.sin(turn), "cos_hour_of_day": np.cos(turn)}
        clock |= {"sin_day_of_year": np.sin(year), "cos_day_of_year": np.cos(year)}
        rows = np.zeros((n, len(card.observations)), dtype=np.float32)
        for name, value in (night | clock | given).items():
            rows[:, card.observation_names.index(name)] = value
        return rows

    return make


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    """Function that writes a file below a fresh folder and returns its path."""

    def write_file(name: str, text: str) -> Path:
        path = tmp_path / "work" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    return write_file
