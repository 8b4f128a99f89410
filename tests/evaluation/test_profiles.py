"""The profile beside a result: the same bytes however it is made, true to the result, and refused when it was changed."""

from __future__ import annotations

import contextlib
import gzip
import json
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import ResultError
from glbench.evaluation import Result, evaluate, load_result
from glbench.evaluation.files import result_path
from glbench.evaluation.profiles import Profile, load_profile, make_profile, profile_path
from glbench.evaluation.profiles.record import unpack
from glbench.evaluation.saving import recorded_actions
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import AgentWriter, agent_writer
from tests.evaluation.test_resume import interrupted_at

LEAVES = """
    def act(self, observations):
        self.calls += 1
        actions = np.full((self.n, 6), 0.01)
        if self.calls > 10:
            actions[1] = np.nan
        return actions
"""
"""The second run fails in its eleventh step."""


def stored(task: TaskSpec, agent: Path, out: Path) -> tuple[Result, Path]:
    evaluate(task, agent, out=out)
    path = result_path(out, task.id, agent.stem)
    return load_result(path), path


def test_an_evaluation_leaves_the_profile_that_its_result_names(day_task, write_agent, tmp_path):
    result, path = stored(day_task, write_agent(), tmp_path)
    profile = load_profile(result, path)
    assert profile is not None
    assert result.profile is not None
    assert (profile_path(path).name, profile.digest) == (result.profile.file, result.profile.digest)
    assert profile_path(path).read_bytes() == profile.to_bytes()


def test_without_a_folder_there_is_no_profile(good_result):
    assert good_result.profile is None


@pytest.mark.parametrize("methods", [None, LEAVES])
def test_replaying_the_actions_gives_the_same_bytes(day_task, write_agent: AgentWriter, tmp_path, methods):
    agent = write_agent() if methods is None else write_agent(methods)
    result, path = stored(day_task, agent, tmp_path)
    again = make_profile(day_task, result, recorded_actions(result, path), None)
    assert again.to_bytes() == profile_path(path).read_bytes()


def test_replaying_few_runs_at_a_time_changes_nothing(day_task, write_agent, tmp_path, monkeypatch):
    result, path = stored(day_task, write_agent(), tmp_path)
    monkeypatch.setattr("glbench.evaluation.profiles.building.LARGEST_TRACE", 1)
    again = make_profile(day_task, result, recorded_actions(result, path), None)
    assert again.to_bytes() == profile_path(path).read_bytes()


def test_an_interruption_changes_nothing(day_task, write_agent, tmp_path):
    agent = write_agent()
    whole, _ = stored(day_task, agent, tmp_path / "whole")
    interrupted_at(11, day_task, agent, tmp_path / "cut")
    resumed, _ = stored(day_task, agent, tmp_path / "cut")
    assert resumed.evaluation.resumed_at_step == 11
    assert resumed.profile == whole.profile


def test_hours_of_the_day_and_the_calendar_add_up_to_the_metrics(day_task, write_agent, tmp_path):
    result, path = stored(day_task, write_agent(LEAVES), tmp_path)
    document = load_profile(result, path).document
    alive = [run.status == "ok" for run in result.runs]
    for column, metric in {"heat": "heat", "electricity": "electricity", "co2_dosed": "co2", "fruit_fresh": "yield"}.items():
        packed = document["hours"][column]
        sums = unpack(packed).sum(axis=0)
        assert sums == pytest.approx(result.values(metric), abs=24 * packed["resolution"]), metric
    rewards = unpack(document["hours"]["reward"]).sum(axis=0)
    assert rewards[alive] == pytest.approx(np.array(result.values("reward"))[alive], abs=1e-2)


def test_the_calendar_of_whole_runs_adds_up_to_the_hours_outside(day_task, write_agent, tmp_path):
    result, path = stored(day_task, write_agent(), tmp_path)
    calendar = load_profile(result, path).document["calendar"]
    for name, packed in calendar.items():
        hours = unpack(packed).sum() / 60.0
        assert hours == pytest.approx(result.summary.mean[f"hours_{name}"], abs=packed["resolution"]), name


def test_the_worst_run_is_the_one_with_the_smallest_metric(day_task, write_agent, tmp_path):
    result, path = stored(day_task, write_agent(LEAVES), tmp_path)
    document = load_profile(result, path).document
    worst = min(result.runs, key=lambda run: run.metrics["reward"])
    assert document["seeds"]["worst"] == worst.seed == result.runs[1].seed
    hours = document["worst"]["air_temperature"]["values"]
    assert [value is None for value in hours] == [hour >= worst.steps for hour in range(24)]


def test_results_of_earlier_versions_still_load_and_have_no_profile(day_task, write_agent, tmp_path):
    _, path = stored(day_task, write_agent(), tmp_path)
    document = json.loads(path.read_text())
    del document["profile"]
    path.write_text(json.dumps(document))
    profile_path(path).unlink()
    earlier = load_result(path)
    assert earlier.profile is None
    assert load_profile(earlier, path) is None


def test_a_changed_profile_is_refused_and_a_damaged_one_too(day_task, write_agent, tmp_path):
    result, path = stored(day_task, write_agent(), tmp_path)
    file = profile_path(path)
    document = json.loads(gzip.decompress(file.read_bytes()))
    document["seeds"]["worst"] += 1
    file.write_bytes(gzip.compress(json.dumps(document).encode()))
    with pytest.raises(ResultError, match=r"is not the profile that agent_under_test\.json names"):
        load_profile(result, path)
    file.write_bytes(b"no gzip")
    with pytest.raises(ResultError, match="Cannot read the profile"):
        load_profile(result, path)


def test_a_profile_of_an_earlier_result_is_not_shown_with_a_new_one(day_task, write_agent, tmp_path):
    _, path = stored(day_task, write_agent(), tmp_path / "first")
    other, other_path = stored(day_task, write_agent(LEAVES), tmp_path / "second")
    profile_path(other_path).write_bytes(profile_path(path).read_bytes())
    assert load_profile(other, other_path) is None


def rewritten(path: Path, text: bytes) -> str:
    """What is said of a profile with ``text`` in it, which the result names."""
    profile_path(path).write_bytes(gzip.compress(text, compresslevel=9))
    document = json.loads(path.read_text(encoding="utf-8"))
    with contextlib.suppress(ValueError, RecursionError):
        document["profile"]["digest"] = Profile(json.loads(text)).digest
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ResultError) as caught:
        load_profile(load_result(path), path)
    return str(caught.value)


@pytest.fixture(scope="module")
def original(day_task, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("original")
    return stored(day_task, agent_writer(folder)(), folder)[1]


@pytest.fixture
def copied(original: Path, tmp_path: Path) -> Path:
    for file in (original, profile_path(original)):
        shutil.copy(file, tmp_path / file.name)
    return tmp_path / original.name


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("seeds", "best"), 5, "its seeds are others"),
        (("seeds", "all"), [1, 2], "its seeds are others"),
        (("day",), {}, "day.slot_seconds"),
        (("day", "columns", "heat", "resolution"), "x", "day.columns.heat.resolution"),
        (("day", "columns", "heat", "resolution"), 1e300, "day.columns.heat.resolution"),
        (("day", "columns", "heat", "values"), [[[1]]], "day.columns.heat.values"),
        (("day", "columns", "heat", "values"), [[10**30]], "day.columns.heat.values"),
        (("season", "columns", "heat", "values"), [[], [], []], "its 'season' has other"),
        (("worst",), {}, "its 'worst' has other"),
        (("weather", "hours"), {}, "its 'weather by hour' has other"),
        (("columns", "heat", "unit"), "\x1b[2J", "cannot be shown"),
        (("task",), {"a": 1}, "task definition"),
        (("script",), "alert(1)", "Extra inputs"),
    ],
    ids=str,
)
def test_a_profile_that_a_page_cannot_show_is_refused_though_the_result_names_it(copied, place, value, words):
    document = json.loads(gzip.decompress(profile_path(copied).read_bytes()))
    inner = document
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    said = rewritten(copied, Profile(document).text)
    assert words in said
    assert said.isprintable()


def test_profiles_that_expand_or_are_nested_without_end(copied):
    text = gzip.decompress(profile_path(copied).read_bytes())
    deep = text.replace(b'"task":{', b'"task":{"z":' + b"[" * 500 + b"]" * 500 + b",", 1)
    assert "nested too deeply" in rewritten(copied, deep)
    assert "nested too deeply" in rewritten(copied, b"[" * 100_000)
    tracemalloc.start()
    said = rewritten(copied, bytes(100 * 2**20))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "expands to more than 24 MiB" in said
    assert peak < 150 * 2**20  # the bytes that the test itself compressed, and what was read of them
