"""A result checks itself: what was changed after it was written does not load."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from glbench.errors import ResultError
from glbench.evaluation import METRIC_NAMES, UNITS, Result, RunResult, load_result, save_result
from glbench.evaluation.records import AgentRecord, results_digest, summarise

Document = dict[str, Any]


@pytest.fixture
def saved(good_result: Result, tmp_path: Path) -> Path:
    return save_result(good_result, tmp_path)


def change(path: Path, edit: Callable[[Document], object]) -> Path:
    document = json.loads(path.read_text(encoding="utf-8"))
    edit(document)
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def test_a_result_reads_back_to_the_last_bit(good_result: Result, saved: Path) -> None:
    assert saved.name == "agent_under_test.json"
    assert saved.parent.name == "Day-v1"
    assert load_result(saved) == good_result


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=len(METRIC_NAMES), max_size=len(METRIC_NAMES)))
def test_every_number_survives_the_file(values: list[float]) -> None:
    run = RunResult(seed=1, status="ok", reason=None, steps=1, metrics=dict(zip(METRIC_NAMES, values, strict=True)))

    back = RunResult.model_validate_json(run.model_dump_json())
    assert [value.hex() for value in back.metrics.values()] == [value.hex() for value in values]


def test_the_file_stands_by_itself(saved: Path) -> None:
    document = json.loads(saved.read_text(encoding="utf-8"))

    assert (document["schema"], document["schema_version"]) == ("glbench/result", 1)
    assert document["units"] == UNITS
    assert document["evaluation"]["seeds"] == [666, 667, 668]
    assert set(document["runs"][0]) == {"seed", "status", "reason", "steps", "metrics"}
    assert set(document["runs"][0]["metrics"]) == set(METRIC_NAMES)
    assert platform.node() not in saved.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda d: d["runs"][1]["metrics"].update(reward=99.0), "the summary does not follow from the runs"),
        (lambda d: (d["runs"].pop(), d["summary"].update(runs=2)), "announces 3 runs .* and holds 2"),
        (lambda d: d["runs"][0].update(seed=1), r"announces 3 runs with the seeds \[666, 667, 668\] and holds 3 with the seeds \[1,"),
        (lambda d: d["runs"][0].update(steps=5), "is 'ok' after 5 of 24 steps"),
        (lambda d: d["runs"][0].update(status="crashed"), "'crashed' with the reason None"),
        (lambda d: d["runs"][0].update(status="fine"), "runs.0.status"),
        (lambda d: d["runs"][0]["metrics"].pop("heat"), r"666 lacks metrics that have a unit \['heat'\]"),
        (lambda d: d["runs"][0]["metrics"].update(beauty=1.0), r"or has some without one \['beauty'\]"),
        (lambda d: d["runs"][0]["metrics"].pop("reward"), "run with seed 666 lacks the metric 'reward'"),
        (lambda d: d["summary"]["mean"].update(reward=99.0), "the summary does not follow from the runs"),
        (lambda d: d["task"].update(digest="0" * 64), "results_digest does not match"),
        (lambda d: d["agent"].update(name="somebody"), "results_digest does not match"),
        (lambda d: d["units"].update(heat="MJ m-2"), "units are not those of this schema"),
        (lambda d: d.pop("machine"), "machine: Field required"),
        (lambda d: d.update(remark="hello"), "remark: Extra inputs"),
        (lambda d: d.update(schema="other"), "is not a result of glbench: its 'schema' is 'other'"),
        (lambda d: d.update(schema_version=2), "has result schema version 2; this glbench reads version 1"),
        (lambda d: d["evaluation"].update(wall_seconds=float("nan")), "evaluation.wall_seconds"),
    ],
)
def test_a_changed_file_is_refused_with_its_reason(saved: Path, edit: Callable[[Document], object], words: str) -> None:
    with pytest.raises(ResultError, match=words):
        load_result(change(saved, edit))


def measured_by_another_version(document: Document, names: Callable[[dict[str, Any]], object]) -> None:
    """Change the metrics of all runs, their units and the summary, as another glbench would have written them."""
    for values in (*(run["metrics"] for run in document["runs"]), document["summary"]["mean"], document["units"]):
        names(values)
    agent = AgentRecord.model_validate(document["agent"])
    runs = tuple(RunResult.model_validate_json(json.dumps(run)) for run in document["runs"])
    document["results_digest"] = results_digest(document["task"]["digest"], agent, runs)


def test_metrics_that_this_version_does_not_know_are_kept_as_they_are(saved: Path) -> None:
    def edit(document: Document) -> None:
        measured_by_another_version(document, lambda values: values.update(water=2.5))
        document["units"]["water"] = "l m-2"

    result = load_result(change(saved, edit))
    assert result.values("water") == (2.5, 2.5, 2.5)
    assert result.to_frame().attrs["units"]["water"] == "l m-2"
    assert json.loads(result.to_json()) == json.loads(saved.read_text(encoding="utf-8"))
    assert result.to_json() == load_result(save_result(result, saved.parents[3])).to_json()


def test_a_result_may_lack_metrics_that_this_version_knows(saved: Path) -> None:
    result = load_result(change(saved, lambda d: measured_by_another_version(d, lambda values: values.pop("heat"))))
    assert "heat" not in result.to_frame().columns
    assert json.loads(result.to_json()) == json.loads(saved.read_text(encoding="utf-8"))
    with pytest.raises(ResultError, match=r"has no metric 'heat'\. It has reward, epi, "):
        result.values("heat")


def test_a_file_without_a_schema_version_is_of_the_first(good_result: Result, saved: Path) -> None:
    assert load_result(change(saved, lambda d: d.pop("schema_version"))) == good_result


def test_a_reward_that_is_changed_with_its_summary_breaks_the_digest(saved: Path) -> None:
    def edit(document: Document) -> None:
        for run in document["runs"]:
            run["metrics"]["reward"] = 50.0
        document["summary"]["mean"]["reward"] = 50.0

    with pytest.raises(ResultError, match="the file was changed after it was written"):
        load_result(change(saved, edit))


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", '"result"', "\x00", '{"schema": "glbench/result"'])
def test_what_is_no_result_is_refused_in_words(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.json"
    path.write_text(text, encoding="utf-8")

    with pytest.raises(ResultError, match=r"broken\.json"):
        load_result(path)


def test_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"There is no result file .*nowhere.json.*glbench evaluate"):
        load_result(tmp_path / "nowhere.json")


@pytest.mark.parametrize("path", [None, 3])
def test_what_is_no_path_is_refused_in_words(path: object) -> None:
    with pytest.raises(ResultError, match=f"got {path}"):
        load_result(path)  # type: ignore[arg-type]


def test_a_file_that_is_no_text_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "picture.json"
    path.write_bytes(b"\xff\xd8\xff\xe0")

    with pytest.raises(ResultError, match="Cannot read the result file"):
        load_result(path)


def test_times_are_no_part_of_the_digest(good_result: Result) -> None:
    slower = good_result.model_copy(
        update={"evaluation": good_result.evaluation.model_copy(update={"wall_seconds": 1e6, "workers": 64}), "created": "2030"}
    )

    assert Result.model_validate_json(slower.to_json()).results_digest == good_result.results_digest


def test_a_frame_has_one_row_a_run_with_units(good_result: Result) -> None:
    frame = good_result.to_frame()

    assert frame.index.name == "seed"
    assert list(frame.index) == [666, 667, 668]
    assert list(frame.columns) == ["status", "reason", "steps", *METRIC_NAMES]
    assert tuple(frame["reward"]) == good_result.values("reward")
    assert frame.attrs["units"]["epi"] == "EUR m-2"
    assert frame.attrs["task"] == "test/Day-v1"


def test_means_count_failed_runs() -> None:
    def run(seed: int, reward: float, *, failed: bool) -> RunResult:
        metrics = dict.fromkeys(METRIC_NAMES, 0.0) | {"reward": reward}
        if failed:
            return RunResult(seed=seed, status="crashed", reason="x", steps=0, metrics=metrics)
        return RunResult(seed=seed, status="ok", reason=None, steps=1, metrics=metrics)

    summary = summarise((run(1, 10.0, failed=False), run(2, -20.0, failed=True)))

    assert summary.mean["reward"] == -5.0
    assert (summary.runs, summary.ok, summary.failed) == (2, 1, 1)
    assert summary.statuses == {"ok": 1, "crashed": 1}


@pytest.mark.parametrize(("metrics", "accepted"), [(("reward", "epi", "penalty"), True), (METRIC_NAMES, False)])
def test_reward_and_penalty_may_be_money_but_not_in_the_papers_tasks(good_result: Result, metrics: tuple[str, ...], accepted: bool) -> None:
    document = json.loads(good_result.to_json())
    document["units"] = {name: "EUR m-2" if name in ("reward", "penalty") else UNITS[name] for name in metrics}
    for run in document["runs"]:
        run["metrics"] = {name: run["metrics"][name] for name in metrics}
    document["summary"]["mean"] = {name: document["summary"]["mean"][name] for name in metrics}
    runs = tuple(RunResult.model_validate_json(json.dumps(run)) for run in document["runs"])
    document["results_digest"] = results_digest(good_result.task.digest, good_result.agent, runs)
    if accepted:
        assert Result.model_validate_json(json.dumps(document)).units["reward"] == "EUR m-2"
    else:
        with pytest.raises(ValidationError, match="units"):
            Result.model_validate_json(json.dumps(document))
