"""Results from elsewhere: whatever a file holds, it is a result or it ends in a sentence, and the others are not kept from their place."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from glbench.errors import ResultError
from glbench.evaluation import Result, load_result, save_result
from glbench.evaluation.records import AgentRecord, results_digest
from glbench.leaderboard.collect import collect_readable
from glbench.resources import data_folder
from glbench.verification import proof_path, read_proof

CARD: dict[str, Any] = {"name": "x", "authors": ["a"], "licence": "MIT", "information": ["observations"]}


@pytest.fixture
def saved(good_result: Result, tmp_path: Path) -> Path:
    return save_result(good_result, tmp_path)


def refused(path: Path, words: str) -> None:
    with pytest.raises(ResultError, match=words) as caught:
        load_result(path)
    assert len(str(caught.value)) < 2000
    assert str(caught.value).replace("\n", " ").isprintable()


def change(path: Path, *place: str | int, value: object) -> Path:
    document = json.loads(path.read_text(encoding="utf-8"))
    inner = document
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def test_all_released_results_load() -> None:
    files = [file for file in data_folder("reports/released/results").rglob("*.json") if ".proof." not in file.name]
    assert len(files) >= 110
    for file in files:
        load_result(file)


@pytest.mark.parametrize(
    "name", ["../../../evil", "<b>x</b>", "x.proof", "X.Proof", "a" * 101, "x\x1b[2J", "", ".hidden", "a/b", "a b", "ключ", "a\n"]
)
def test_a_name_that_results_cannot_be_filed_under(good_result: Result, saved: Path, name: str) -> None:
    document = json.loads(saved.read_text(encoding="utf-8"))
    document["agent"]["name"] = name
    agent = AgentRecord.model_construct(**{**good_result.agent.__dict__, "name": name})
    document["results_digest"] = results_digest(good_result.task.digest, agent, good_result.runs)
    saved.write_text(json.dumps(document), encoding="utf-8")
    refused(saved, r"agent\.name: an agent's name has 1 to 100 letters")


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("agent", "kind"), "official", "agent.kind"),
        (("agent", "information"), "x" * 3000, "agent.information"),
        (("agent", "card"), {**CARD, "seed": 10**30}, "agent.card.seed"),
        (("agent", "card"), {**CARD, "seed": 10**4000}, "agent.card.seed"),
        (("agent", "card"), {**CARD, "training": {"steps": 10**30}}, "agent.card.training.steps"),
        (("agent", "card"), {**CARD, "requires": ["a"] * 1000}, "agent.card.requires"),
        (("evaluation", "workers"), 10**30, "evaluation.workers"),
        (("evaluation", "decision_seconds"), 1e300, "evaluation.decision_seconds"),
        (("evaluation", "kernel"), {str(i): 0.0 for i in range(1000)}, "evaluation.kernel"),
        (("evaluation", "kernel", "backend"), "\x1b[2J", "U.001B cannot be shown"),
        (("evaluation", "limits"), {"x" * 1000: 1.0}, "evaluation.limits"),
        (("machine", "processor"), "line\nline", "machine.processor"),
        (("machine", "cores"), -1, "machine.cores"),
        (("created",), "x" * 1000, "created"),
        (("task", "id"), "../../evil-v1", "task.id"),
        (("task", "steps"), 10**12, "task.steps"),
        (("task", "step_seconds"), 1e-9, "task.step_seconds"),
        (("runs", 0, "seed"), 2**60, "runs.0.seed"),
        (("runs", 0, "metrics", "reward"), 1e308, "metric above"),
        (("units",), {str(i): "-" for i in range(1000)}, "units"),
        (("\x1b[2J",), 1, "Extra inputs"),
        (("schema",), "\x1b[2J" * 1000, "is not a result of glbench"),
        (("schema_version",), 10**4000, "schema version"),
    ],
    ids=str,
)  # fmt: skip
def test_fields_out_of_bounds(saved: Path, place: tuple[str | int, ...], value: object, words: str) -> None:
    refused(change(saved, *place, value=value), words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"git": ', '"git": ' + "[" * 100_000 + "]" * 100_000 + ', "x": ', "no valid JSON .*nested too deeply"),
        ('"schema": "glbench/result"', '"schema": ' + "[" * 300 + "]" * 300, "is not a result of glbench"),
        ('"workers": 1', '"workers": ' + "9" * 10_000, "no valid JSON .*digits"),
        ('"created": "', '"created": "\\ud800', "Invalid JSON|surrogate"),
    ],
    ids=["deep", "rather deep", "digits", "half a character"],
)
def test_texts_that_python_does_not_like(saved: Path, old: str, new: str, words: str) -> None:
    text = saved.read_text(encoding="utf-8")
    assert old in text
    saved.write_text(text.replace(old, new, 1), encoding="utf-8")
    refused(saved, words)


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes in folders")
def test_pipes_links_in_a_circle_and_devices_are_not_read(good_result: Result, tmp_path: Path) -> None:
    good = save_result(good_result, tmp_path)
    pipe, circle, endless, folder = (good.with_name(f"{name}.json") for name in ("pipe", "circle", "endless", "folder"))
    os.mkfifo(pipe)
    circle.symlink_to(circle)
    endless.symlink_to("/dev/zero")
    folder.mkdir()
    os.mkfifo(proof_path(good))
    for path in (pipe, endless, folder):
        refused(path, "not a regular file")
    refused(circle, "Cannot read")
    assert read_proof(good) is None
    results, problems = collect_readable([tmp_path])
    assert [item.path for item in results] == [good]
    assert len(problems) == 4


def test_a_file_larger_than_any_result_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    path.touch()
    os.truncate(path, 2**30)
    refused(path, "larger than 32 MiB")


def test_a_reason_that_steers_a_terminal_is_recorded_without_that(day_task, write_agent, tmp_path) -> None:
    from glbench.evaluation import evaluate, result_path

    body = "def act(self, observations):\n    raise ValueError('\\x1b[2J\\ud800 gone ' + 'x' * 100_000)"
    result = evaluate(day_task, write_agent(body), out=tmp_path)
    reason = result.runs[0].reason
    assert reason is not None
    assert reason.isprintable()
    assert "gone" in reason
    assert load_result(result_path(tmp_path, day_task.id, "agent_under_test")).runs == result.runs
