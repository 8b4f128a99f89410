"""A file that somebody forged spoils no table: it is left out by name, with the reason, and the rest is shown."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from glbench.cli.view import _episode
from glbench.errors import EpisodeError, ResultError
from glbench.evaluation import evaluate, load_result
from glbench.evaluation.profiles import Profile, profile_path, read_profile
from glbench.evaluation.records import FreshDraws
from glbench.evaluation.saving import task_of_result
from glbench.leaderboard import StoredResult, rank
from glbench.leaderboard.collect import own_and_released_results, published_expectations
from glbench.report.page import complete_profiles
from glbench.tasks import get_task
from tests.report.conftest import write_agent
from tests.support import write_day_task
from tests.verification.forging import record_of, rewrite, rewrite_record

Change = Callable[[dict[str, Any]], Any]
RELEASED = Path(__file__).resolve().parents[2] / "reports" / "released" / "results"
TASK = "Schiphol2010-Delta10-v1"


@pytest.fixture
def nothing_released(tmp_path, monkeypatch):
    """No results came with glbench; reading all of them takes seconds."""
    monkeypatch.setattr("glbench.leaderboard.collect.data_folder", lambda _: tmp_path / "nothing")


@pytest.fixture
def forge(tmp_path: Path) -> Callable[..., Path]:
    """Function that writes the result of a stranger called mallory, with one change, and returns its path."""

    def write(change: Change, task: str = TASK) -> Path:
        path = tmp_path / "results" / task / "mallory.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text((RELEASED / task / "do_nothing.json").read_text())
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


@pytest.mark.usefixtures("nothing_released")
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda document: document["task"].pop("split"), id="split"),
        pytest.param(lambda document: document["units"].update(reward="-"), id="reward"),
        pytest.param(lambda document: document["units"].update(heat="MJ m-2"), id="heat"),
    ],
)
def test_a_split_or_units_that_are_not_those_of_the_task_are_left_out_by_name(forge, tmp_path, change):
    honest = forge(lambda document: None, "Spring-v1")
    assert not own_and_released_results(tmp_path)[1]
    honest.rename(honest.with_name("honest.json"))
    path = forge(change, "Spring-v1")
    stored, (problem,) = own_and_released_results(tmp_path)
    assert [item.path.name for item in stored] == ["honest.json"]
    assert str(problem).startswith(f"{path} states a split or units that are not those of 'glbench/Spring-v1'")


@pytest.mark.usefixtures("nothing_released")
def test_the_title_of_a_board_is_that_of_its_task(forge, tmp_path):
    forge(lambda document: document["task"].update(title="All others cheat"))
    stored, problems = own_and_released_results(tmp_path)
    assert not problems
    (table,) = rank([item for item in stored if item.result.task.id.endswith(TASK)], published_expectations())
    assert table.title == get_task(TASK).title


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


def with_references(values: Sequence[float], factor: float = 1.0) -> Change:
    """A change that adds fresh draws beside a reference agent with these ``values``, and multiplies all metrics of the agent."""

    def change(document: dict[str, Any]) -> None:
        document["task"] |= {"split": "test"}
        for run in document["runs"]:
            run["metrics"] = {name: value * factor * (-1.0) ** run["seed"] for name, value in run["metrics"].items()}
        reference = {"name": "rule_based", "digest": "c" * 64, "published": list(values), "fresh": [0.0] * len(values)}
        fresh = {"salt": "b" * 64, "metric": "reward", "runs": document["runs"], "references": [reference], "digest": "0" * 64}
        document["fresh_draws"] = fresh | {"record": {"file": "x.mcap", "digest": "d" * 64}}

    return change


RUNS = 100


@pytest.mark.usefixtures("nothing_released")
@pytest.mark.parametrize(
    ("values", "factor", "words"),
    [
        ([1e80 * (-1) ** i for i in range(RUNS)], 1.0, "cannot be ranked: The result of mallory on glbench/Spring-v1 has numbers"),
        ([1e-90 * i for i in range(RUNS)], 0.0, "cannot be ranked: The result of mallory on glbench/Spring-v1 has numbers"),
        ([0.0] * RUNS, 1e95, "cannot be ranked: The result of mallory on glbench/Spring-v1 has numbers"),
        ([1e300] * RUNS, 1.0, "a reference agent has a metric above 1e+100"),
    ],
)
def test_numbers_that_no_test_of_a_drop_can_take_are_left_out_by_name(forge, tmp_path, values, factor, words):
    path = forge(with_references(values, factor), "Spring-v1")
    document = json.loads(path.read_text())
    fresh = FreshDraws.model_validate_json(json.dumps(document["fresh_draws"]))
    document["fresh_draws"]["digest"] = fresh.computed_digest(document["results_digest"])
    path.write_text(json.dumps(document))
    stored, (problem,) = own_and_released_results(tmp_path)
    assert not stored
    assert str(path) in str(problem)
    assert words in str(problem)


def define(path: Path, table: str, **changes: Any) -> None:
    """Change a table of the definition in the profile of a result."""
    profile = read_profile(profile_path(path))
    task = profile.document["task"]
    forged = Profile(dict(profile.document) | {"task": task | {table: task[table] | changes}})
    profile_path(path).write_bytes(forged.to_bytes())


@pytest.mark.usefixtures("nothing_released")
@pytest.mark.parametrize("changes", [{"metric": "epi"}, {"first_seed": 5000}, {"runs": 2}])
def test_a_forged_definition_of_a_users_task_decides_nothing(own, changes):
    honest = rank(own_and_released_results(own.parents[1])[0], {})
    for name in ("thrifty", "lavish"):
        define(own / f"{name}.json", "evaluation", **changes)
        (table,) = rank(own_and_released_results(own.parents[1])[0], {})
        assert (table.metric, table.rows) == (honest[0].metric, honest[0].rows)


@pytest.mark.usefixtures("nothing_released")
@pytest.mark.parametrize(("table", "changes"), [("model", {"variant": "nobody's"}), ("model", {"parameters": "nobody's"})])
def test_a_definition_that_cannot_be_resolved_is_none(own, table, changes):
    define(own / "thrifty.json", table, **changes)
    stored, problems = own_and_released_results(own.parents[1])
    assert not problems
    assert [item.task is None for item in sorted(stored, key=lambda one: one.result.agent.name)] == [False, True]
    assert len(rank(stored, {})[0].rows) == 2


def test_a_definition_in_the_record_needs_the_digest_of_the_result_too(own):
    path = own / "thrifty.json"
    profile_path(path).unlink()
    assert StoredResult(path, load_result(path)).task is not None
    rewrite_record(path, lambda log: replace(log, definition=log.definition.replace(b'"metric": "reward"', b'"metric": "epi"')))
    assert StoredResult(path, load_result(path)).task is None


@pytest.mark.usefixtures("nothing_released")
@pytest.mark.parametrize("has_definition", [True, False])
def test_seeds_that_a_stranger_chose_are_a_trial_on_a_users_task_too(days, own, has_definition):
    shutil.copy(days / "thrifty.py", days / "chosen.py")
    evaluate(write_day_task(days), days / "chosen.py", out=days, runs=3, first_seed=5000)
    for file in (days / "trials" / "results" / "Day-v1").glob("chosen*"):
        shutil.copy(file, own)
    if not has_definition:
        profile_path(own / "chosen.json").unlink()
        record_of(own / "chosen.json").unlink()
    (table,) = rank(own_and_released_results(own.parents[1])[0], {})
    ranked = {row.agent: (row.rank is not None, row.origin) for row in table.rows}
    assert ranked == {"thrifty": (True, "own"), "lavish": (True, "own"), "chosen": (False, "trial")}


@pytest.mark.parametrize("first", ["honest", "forged"])
def test_of_two_versions_with_equally_many_results_a_claimed_date_does_not_beat_a_reproduced_result(store, first):
    honest = replace(store("honest", [1.0]), reproduced=True)
    forged = store("forged", [1.0], task_digest="f" * 64, created="9999-01-01T00:00:00Z")
    stored = [honest, forged] if first == "honest" else [forged, honest]
    with pytest.raises(ResultError, match=r"forged\.json is of another version"):
        rank(stored, {})
