"""What docs/tasks.md, task-file.md, schedule.md, observations.md and uncertainty.md show is true."""

from __future__ import annotations

import datetime as dt
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.env import GreenhouseEnv
from glbench.errors import TaskError
from glbench.tasks import TaskFile1, get_task, list_drafts, list_tasks
from glbench.tasks.prices import PriceTableTable
from glbench.tasks.schedule import ScheduleEntry
from glbench.tasks.tables import (
    ActuatorTable,
    FaultsTable,
    ForecastTable,
    ItemTable,
    ParameterGroupTable,
    RewardTable,
    SampleTable,
    ScaledSensorTable,
    ScenarioTable,
    SensorTable,
    SplitTable,
    StartGroupTable,
    WindLimitTable,
)
from glbench.weather import load_weather, save_weather

Write = Callable[[str], Path]
DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("tasks.md", "task-file.md", "schedule.md", "observations.md", "uncertainty.md")


@pytest.fixture(scope="module")
def page() -> str:
    return "\n".join((DOCS / name).read_text(encoding="utf-8") for name in PAGES)


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL)


def block(page: str, language: str, words: str) -> str:
    """The first block with ``words`` in it."""
    return next(found for found in blocks(page, language) if words in found)


def run_block(page: str, words: str) -> dict[str, Any]:
    """Names of the block of Python with ``words`` in it, after it ran."""
    names: dict[str, Any] = {}
    exec(compile(block(page, "python", words), ", ".join(PAGES), "exec"), names)
    return names


def test_a_task_of_ones_own_is_five_lines_in_a_file_and_the_same_in_python(page: str, write: Write) -> None:
    text = block(page, "toml", "DearHeat")
    assert len(text.splitlines()) == 6, "five lines, and a title"
    ours, theirs = run_block(page, ".replace(")["task"], get_task(write(text))
    assert (ours.digest, ours.changes, ours.id) == (theirs.digest, theirs.changes, theirs.id)
    assert [change.key for change in ours.changes] == ["weather.days", "ledger.cost_heat.price", "sensors"]
    assert ours.schema_version == 2
    assert (ours.weather.days, ours.file.ledger["cost_heat"].price, ours.sensors) == (30, 0.06, None)


def test_the_overrides_shown_run_in_gymnasium(page: str) -> None:
    names = run_block(page, "overrides=")
    env, envs = names["env"], names["envs"]
    assert env.unwrapped.task == get_task("GreenhouseReal-v1").replace({"weather.days": 30, "sensors": None})
    assert envs.unwrapped.task.observation.forecast.error == "perfect"
    env.reset(seed=1)
    envs.close()


def test_the_mistake_shown_is_told_so(page: str) -> None:
    with pytest.raises(TaskError) as caught:
        get_task("Spring-v1").replace({"weather.days": 0})
    words = re.search(r"what is allowed: `(.*?)`", page)
    assert words is not None
    assert words[1] in str(caught.value)


def test_the_task_with_a_test_alone_is_one(page: str, write: Write) -> None:
    task = get_task(write(block(page, "toml", "Spring2012")))
    assert (task.split, task.scenario.generated) == ("test", None)
    assert [season.start.year for season in task.scenario.seasons] == [2012]
    preview = GreenhouseEnv(task).task
    assert (preview.split, preview.season_years) == ("preview", (2008, 2009, 2010))
    GreenhouseEnv(task, split="test").reset(seed=1)


def test_the_whole_file_shown_is_a_task(page: str, write: Write) -> None:
    task = get_task(write(block(page, "toml", "December2011")))
    assert (task.id, task.steps) == ("mylab/December2011-v1", 7 * 288)
    assert len(task.observed()) == 22 + 12 * 5
    assert task.uncertain_parameters() == ("rgFruit", "sla")


def test_the_task_of_schema_2_shown_is_one(page: str, write: Write) -> None:
    task = get_task(write(block(page, "toml", "Harvest-v1")))
    assert (task.schema_version, task.model_value.id) == (2, "greenlight-tomato-harvest-1.0.0")
    assert [item.name for item in task.ledger.earned] == ["revenue", "standing"]
    assert (len(task.scenario.seasons), len(task.scenario.groups[0].parameters)) == (3, 28)


def test_the_schedule_shown_is_what_the_words_say(page: str, write: Write) -> None:
    task = get_task(write(block(page, "toml", "DarkNights-v1")))
    assert list(task.scheduled_places) == ["uBlScr"]
    assert [entry.in_words() for entry in task.schedule] == ["20:00 to 06:00", "Monday and Thursday, 07:00 to 15:00, 1 April to 30 June"]
    assert task.observed()[-1].name == "blackout_screen_scheduled"


def test_every_key_of_schema_2_is_explained(page: str) -> None:
    for record in (
        ItemTable, PriceTableTable, ScenarioTable, ParameterGroupTable, StartGroupTable, RewardTable, SplitTable, SensorTable,
        FaultsTable, ForecastTable, ScheduleEntry, ActuatorTable, WindLimitTable, ScaledSensorTable,
        SampleTable,
    ):  # fmt: skip
        for name, field in record.model_fields.items():
            assert field.exclude or f"`{field.alias or name}`" in page, name


def test_the_published_modules_shown_have_263_columns(page: str, write: Write) -> None:
    whole, published = block(page, "toml", "December2011"), block(page, "toml", "published_time")
    kept = re.sub(r"modules = \[\"indoor.*\n|timing = .*\n|forecast = .*\n", "", whole)
    task = get_task(write(kept.replace("[observation]\n", "[observation]\n" + published)))
    assert len(task.observed()) == 263


def test_the_python_shown_runs(page: str) -> None:
    run_block(page, "task_card(task)")


def test_every_shipped_suite_and_draft_is_named(page: str) -> None:
    for task in list_drafts():
        assert f"`{task.id}`" in page
    for suite in {name for task in (*list_tasks(), *list_drafts()) for name in task.suites}:
        assert f"`{suite}`" in page


def test_every_key_is_explained(page: str) -> None:
    shown = tomllib.loads(block(page, "toml", "December2011"))
    fields = {field.alias or name for name, field in TaskFile1.model_fields.items()}
    assert fields == set(shown) | {"description", "suites"}
    for table, content in shown.items():
        assert f"`{table}`" in page or f"**`[{table}]`**" in page
        for key in content if isinstance(content, dict) else ():
            assert f"`{key}`" in page


def test_every_word_is_explained(page: str, shipped_words: dict[str, list[str]]) -> None:
    assert len(shipped_words) == 10
    for kind, names in shipped_words.items():
        assert names, kind
        for name in names:
            assert f"`{name}`" in page


def keep_record(name: str, days: int) -> None:
    """So many days from local midnight of 1 May 2024, with the weather of another year, kept under a name."""
    source = load_weather("schiphol")
    begin = int(dt.datetime(2024, 4, 30, 22, tzinfo=dt.UTC).timestamp())
    counts = {name: values[24 * 120 : 24 * (120 + days)] for name, values in source.counts.items()}
    save_weather(replace(source, name=name, begin=begin, counts=counts), name)


def test_the_task_with_weather_of_ones_own_runs(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))
    text = block((DOCS / "weather.md").read_text(encoding="utf-8"), "toml", "OwnWeather-v1")
    keep_record("my-greenhouse", 12)
    with GreenhouseEnv(write(text), split="test") as env:
        env.reset(seed=1)
        env.step(env.action_space.sample())
    assert env.task.steps == 960
    late = text.replace("scenario.start_within_days = 0\n", "")
    with pytest.raises(TaskError, match=r"28 days by which it may start later \(scenario.start_within_days = 28; 0 needs"):
        get_task(write(late))
    keep_record("short", 11)
    checked = CliRunner().invoke(app, ["tasks", "check", str(write(text.replace("my-greenhouse", "short")))])
    assert checked.exit_code == 1
    assert "2 days beyond its end, which are observed or forecast" in " ".join(checked.stdout.split())
