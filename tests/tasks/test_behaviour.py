"""What is computed from a published task is frozen as well: weather, draws, accounts and reward."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.cli.tasks import app
from glbench.env import behaviour, uncertainty
from glbench.errors import TaskError
from glbench.model import greenlight
from glbench.tasks import get_task, list_tasks
from glbench.weather import COLUMNS, paper
from tests.support import published_tasks
from tests.tasks.names import SHORT_ID


@pytest.fixture(autouse=True)
def fresh(forget: Callable[[], None]) -> None:
    """The weather is computed anew before and after every test."""
    forget()


def refused(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", "200")
    done = CliRunner().invoke(app, ["check", SHORT_ID])
    assert done.exit_code == 1, done.stdout
    assert get_task(SHORT_ID).locked, "the digest alone does not see it"
    return str(done.stdout)


def scaled_weather(monkeypatch: pytest.MonkeyPatch, change: Callable[[np.ndarray], None]) -> None:
    prepare = paper.prepare

    def changed(*arguments: Any) -> Any:
        prepared = prepare(*arguments)
        values = prepared.values.copy()
        change(values)
        return dataclasses.replace(prepared, values=values)

    monkeypatch.setattr(paper, "prepare", changed)


@pytest.mark.parametrize("task_id", [task.id for task in published_tasks()])
def test_every_published_task_behaves_as_published(task_id: str) -> None:
    behaviour.check_behaviour(get_task(task_id))
    assert len(behaviour.read_behaviour()[task_id]) >= len(COLUMNS) + 2 + 23 + 2


def test_brighter_sunlight_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    scaled_weather(monkeypatch, lambda values: values[:, 0].__imul__(1.2))
    words = refused(monkeypatch)
    assert "weather.iGlob (locked 1315636.5, found 1578763.8)" in words
    assert "weather.tOut" not in words


@pytest.mark.parametrize("column", range(len(COLUMNS)))
@pytest.mark.parametrize("row", [1, 2881, 5760])
def test_one_changed_row_of_any_column_is_seen(monkeypatch: pytest.MonkeyPatch, column: int, row: int) -> None:
    def change(values: np.ndarray) -> None:
        values[row, column] += 1e-3 * np.abs(values[:, column]).mean()

    scaled_weather(monkeypatch, change)
    with pytest.raises(TaskError, match=rf"weather\.{COLUMNS[column]} "):
        behaviour.check_behaviour(get_task(SHORT_ID))


def test_two_rows_exchanged_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    def change(values: np.ndarray) -> None:
        values[[40, 50]] = values[[50, 40]]

    scaled_weather(monkeypatch, change)
    with pytest.raises(TaskError, match=r"weather\.iGlob"):
        behaviour.check_behaviour(get_task(SHORT_ID))


def test_another_kilowatt_hour_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(greenlight, "JOULES_PER_KWH", 3.5e6)
    words = refused(monkeypatch)
    for name in ("step.reward", "step.epi", "step.cost_heat", "step.cost_electricity"):
        assert f"{name} (locked" in words
    assert "step.revenue" not in words


def test_other_draws_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    key = uncertainty.draw_key
    monkeypatch.setattr(uncertainty, "draw_key", lambda task_id, seed: key(task_id, seed + 1))
    assert "step.parameters (locked" in refused(monkeypatch)


def test_what_rounding_may_differ_in_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    scaled_weather(monkeypatch, lambda values: values.__imul__(1.0 + 1e-13))
    behaviour.check_behaviour(get_task(SHORT_ID))


def test_a_task_without_an_entry_is_told_how_to_get_one(published: Path) -> None:
    (published / "behaviour.toml").unlink()
    done = CliRunner().invoke(app, ["check"])
    assert (done.exit_code, done.stdout.count("Add it with `glbench tasks lock`.")) == (1, 2)
    assert CliRunner().invoke(app, ["lock"]).stdout.count("in tasks/behaviour.toml") == 2
    assert CliRunner().invoke(app, ["check"]).exit_code == 0


def test_entries_are_added_and_never_changed(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = published / "behaviour.toml"
    before = file.read_text(encoding="utf-8")
    monkeypatch.setattr(greenlight, "JOULES_PER_KWH", 3.5e6)
    assert behaviour.lock_behaviour(list_tasks()) == ()
    assert file.read_text(encoding="utf-8") == before


def test_a_damaged_file_is_told(published: Path) -> None:
    (published / "behaviour.toml").write_text("[a]\nb = 1\n", encoding="utf-8")
    with pytest.raises(TaskError, match=r"Cannot read .*behaviour\.toml"):
        behaviour.read_behaviour()
