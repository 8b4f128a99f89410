"""A file that somebody forged spoils no table: it is left out by name, with the reason, and the rest is shown."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from glbench.cli.view import _episode
from glbench.errors import EpisodeError
from glbench.evaluation import evaluate, load_result
from glbench.evaluation.profiles import profile_path
from glbench.evaluation.saving import task_of_result
from glbench.leaderboard import StoredResult, rank
from glbench.leaderboard.collect import own_and_released_results, published_expectations
from glbench.report.page import complete_profiles
from tests.report.conftest import write_agent
from tests.support import write_day_task
from tests.verification.forging import rewrite

Change = Callable[[dict[str, Any]], Any]
RELEASED = Path(__file__).resolve().parents[2] / "reports" / "released" / "results"
TASK = "Schiphol2010-Delta10-v1"


@pytest.fixture
def nothing_released(tmp_path, monkeypatch):
    """No results came with glbench; reading all of them takes seconds."""
    monkeypatch.setattr("glbench.leaderboard.collect.data_folder", lambda _: tmp_path / "nothing")


@pytest.fixture
def forge(tmp_path: Path) -> Callable[[Change], Path]:
    """Function that writes the result of a stranger called mallory, with one change, and returns its path."""

    def write(change: Change) -> Path:
        path = tmp_path / "results" / TASK / "mallory.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text((RELEASED / TASK / "do_nothing.json").read_text())
        stranger = {"name": "mallory", "kind": "submission", "digest": "a" * 64}
        rewrite(path, lambda document: (document["agent"].update(stranger), change(document)))
        return path

    return write


@pytest.fixture(scope="module")
def days(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the results of two agents on a task of the user's own."""
    folder = tmp_path_factory.mktemp("days")
    for name in ("thrifty", "lavish"):
        evaluate(write_day_task(folder), write_agent(folder, name), out=folder)
    return folder


@pytest.fixture
def own(days: Path, tmp_path: Path) -> Path:
    """A copy of the two results; ``thrifty.json`` in it is theirs who forge."""
    shutil.copytree(days / "results", tmp_path / "results")
    return tmp_path / "results" / "Day-v1"


def test_a_split_that_the_task_does_not_have_is_left_out_by_name(forge, tmp_path):
    path = forge(lambda document: document["task"].update(split="validation"))
    stored, (problem,) = own_and_released_results(tmp_path)
    assert str(problem).startswith(f"{path} cannot be ranked: glbench/{TASK} has no split 'validation'")
    tables = rank([item for item in stored if item.result.task.id.endswith(TASK)], published_expectations())
    assert [table.task_id for table in tables] == [f"glbench/{TASK}"]
    assert "mallory" not in {row.agent for row in tables[0].rows}


def test_a_split_that_the_task_does_not_have_is_named_with_its_file_by_other_commands(own):
    path = own / "thrifty.json"
    rewrite(path, lambda document: document["task"].update(split="validation"))
    profile_path(path).unlink()
    result = load_result(path)
    words = r"thrifty\.json cannot be simulated again: test/Day-v1 has no split 'validation'"
    with pytest.raises(EpisodeError, match=words):
        task_of_result(result, path)
    with pytest.raises(EpisodeError, match=words):
        _episode(path, "best")
    ((where, reason),) = complete_profiles([StoredResult(path, result)]).impossible
    assert where == path
    assert "no split 'validation'" in reason
