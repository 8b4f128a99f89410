"""What docs/tasks.md shows is true."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import gymnasium
import pytest

from glbench.tasks import TaskFile1, TaskSpec, get_task
from glbench.tasks.tables import (
    AnyRewardTable,
    ItemTable,
    ParameterGroupTable,
    PriceTableTable,
    ScenarioTable,
    StartGroupTable,
)

PAGE = Path(__file__).parents[2] / "docs" / "tasks.md"


@pytest.fixture(scope="module")
def page() -> str:
    return PAGE.read_text(encoding="utf-8")


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL)


def test_the_task_with_a_base_shown_runs_in_gymnasium(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spring2011.toml").write_text(blocks(page, "toml")[0], encoding="utf-8")
    names: dict[str, object] = {}
    exec(compile(blocks(page, "python")[1], str(PAGE), "exec"), names)
    task, env = names["task"], names["env"]
    assert isinstance(task, TaskSpec)
    assert isinstance(env, gymnasium.Env)
    assert (task.base, [change.key for change in task.changes]) == (
        "glbench/Schiphol2010-Delta10-v1",
        ["weather.start", "constraints.relative_humidity", "prices.heat"],
    )
    assert env.unwrapped.task == task
    env.reset(seed=1)


def test_the_whole_file_shown_is_a_task(page: str, write: Callable[[str], Path]) -> None:
    task = get_task(write(blocks(page, "toml")[1]))
    assert (task.id, task.steps) == ("mylab/December2011-v1", 7 * 288)
    assert len(task.observed()) == 22 + 12 * 5
    assert task.uncertain_parameters() == ("rgFruit", "sla")


def test_the_task_of_schema_2_shown_is_one(page: str, write: Callable[[str], Path]) -> None:
    task = get_task(write(blocks(page, "toml")[2]))
    assert (task.schema_version, task.model_value.id) == (2, "greenlight-tomato-harvest-1.0.0")
    assert [item.name for item in task.ledger.earned] == ["revenue", "standing"]
    assert (len(task.scenario.seasons), len(task.scenario.groups[0].parameters)) == (3, 28)


def test_every_key_of_schema_2_is_explained(page: str) -> None:
    for record in (ItemTable, PriceTableTable, ScenarioTable, ParameterGroupTable, StartGroupTable, AnyRewardTable):
        for name, field in record.model_fields.items():
            assert field.exclude or f"`{name}`" in page, name


def test_the_published_modules_shown_have_263_columns(page: str, write: Callable[[str], Path]) -> None:
    _, whole, _, published = blocks(page, "toml")
    kept = re.sub(r"modules = \[\"indoor.*\n|timing = .*\n|forecast = .*\n", "", whole)
    task = get_task(write(kept.replace("[observation]\n", "[observation]\n" + published)))
    assert len(task.observed()) == 263


def test_the_python_shown_runs(page: str) -> None:
    exec(compile(blocks(page, "python")[0], str(PAGE), "exec"), {})


def test_every_key_is_explained(page: str) -> None:
    shown = tomllib.loads(blocks(page, "toml")[1])
    fields = {field.alias or name for name, field in TaskFile1.model_fields.items()}
    assert fields == set(shown) | {"description", "suites"}
    for table, content in shown.items():
        assert f"`{table}`" in page or f"**`[{table}]`**" in page
        for key in content if isinstance(content, dict) else ():
            assert f"`{key}`" in page


def test_every_word_is_explained(page: str, shipped_words: dict[str, list[str]]) -> None:
    assert len(shipped_words) == 8
    for kind, names in shipped_words.items():
        assert names, kind
        for name in names:
            assert f"`{name}`" in page
