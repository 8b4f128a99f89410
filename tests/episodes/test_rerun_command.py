"""``glbench view`` and ``glbench evaluate --live`` from the command line."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import glbench.cli.evaluate as evaluate_command
from glbench.cli.app import main
from glbench.evaluation import evaluate, load_result, result_path
from glbench.tasks import get_task
from tests.episodes.rerun_runs import Runs, make_runs, read_recording
from tests.episodes.test_rerun_viewer import stream_into
from tests.verification.forging import rewrite_record

pytest.importorskip("rerun", reason="the viewer (rerun-sdk) is not installed")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    return make_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)


def glbench(*arguments: object) -> int:
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    return int(left.value.code or 0)


def test_results_and_files_are_laid_over_each_other(runs: Runs, tmp_path: Path) -> None:
    file = tmp_path / "both.rrd"
    assert glbench("view", runs.episode_file(667), runs.steady, "--run", 667, "--save", file) == 0
    curves = read_recording(file).curves
    recorded = runs.episode(667)["air_temperature"]
    assert curves["/climate/air_temperature/rule_based"].values.tobytes() == np.ascontiguousarray(recorded).tobytes()
    assert "/climate/air_temperature/steady" in curves


def test_an_episode_is_one_run(runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert glbench("view", runs.episode_file(667), "--run", 668, "--save", tmp_path / "one.rrd") == 1
    assert "an episode (.mcap) is one run" in " ".join(capsys.readouterr().err.split())


def test_a_run_without_a_full_episode_is_taken_again_from_its_actions(runs: Runs, tmp_path: Path) -> None:
    assert not runs.episode_file(668, "steady").exists()
    assert glbench("view", runs.steady, "--run", 668, "--save", tmp_path / "one.rrd") == 0
    epi = read_recording(tmp_path / "one.rrd").curves["/money/epi/steady"].values[-1]
    assert epi == load_result(runs.steady).runs[2].metrics["epi"]


@pytest.mark.parametrize("word", ["best", "worst", "median"])
def test_best_worst_and_median_go_by_the_tasks_metric(word: str, runs: Runs, tmp_path: Path) -> None:
    rewards = sorted(load_result(runs.rule_based).values("reward"))
    assert glbench("view", runs.rule_based, "--run", word, "--save", tmp_path / "one.rrd") == 0
    shown = read_recording(tmp_path / "one.rrd").curves["/money/reward/rule_based"].values[-1]
    assert shown == rewards[{"worst": 0, "median": 1, "best": 2}[word]]


def test_a_record_with_another_task_definition_is_not_shown(runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The result and its record agree; the definition alone, which titles and limits come from, is another."""
    shutil.copytree(runs.folder / "results", tmp_path / "results")
    result = tmp_path / "results" / "Short-v1" / "steady.json"
    rewrite_record(result, lambda log: replace(log, definition=log.definition.replace(b'"high": 34.0', b'"high": 45.0')))
    assert glbench("view", result, "--run", 668, "--save", tmp_path / "one.rrd") == 1
    assert "is of another version of" in " ".join(capsys.readouterr().err.split())


def test_one_run_is_counted_as_one(runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate(get_task(runs.task_file), "rule_based", out=tmp_path, runs=1, episodes="none")
    result = result_path(tmp_path / "trials", load_result(runs.rule_based).task.id, "rule_based")
    assert glbench("view", result, "--run", "median", "--save", tmp_path / "one.rrd") == 0
    assert "the median of 1 run\n" in capsys.readouterr().err


def test_an_episode_of_another_evaluation_is_not_taken_for_the_results(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(runs.folder / "results", tmp_path / "results")
    other = tmp_path / "episodes" / "Short-v1" / "steady" / "seed-666.mcap"
    other.parent.mkdir(parents=True)
    shutil.copy(runs.episode_file(666, "rule_based"), other)
    result = tmp_path / "results" / "Short-v1" / "steady.json"
    assert glbench("view", result, "--run", 666, "--save", tmp_path / "one.rrd") == 0
    assert "is of another evaluation" in capsys.readouterr().err
    assert "/money/epi/steady" in read_recording(tmp_path / "one.rrd").curves


def test_a_cut_file_shows_what_is_left_of_it(runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = runs.episode_file().read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 2 // 3])
    assert glbench("view", cut, "--save", tmp_path / "cut.rrd") == 0
    assert "Shown is what is left of it" in capsys.readouterr().err
    values = read_recording(tmp_path / "cut.rrd").curves["/climate/co2/rule_based"].values
    assert 0 < len(values) < 96
    assert values.tobytes() == np.ascontiguousarray(runs.episode()["co2"][: len(values)]).tobytes()


def test_mistakes_are_answered_in_words(runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save = ("--save", tmp_path / "x.rrd")
    for arguments, words in {
        (runs.rule_based,): "There is no screen here",
        (runs.rule_based, "--run", "bset", *save): "Did you mean 'best'?",
        (runs.rule_based, "--run", "all", *save): "does not choose one run",
        (runs.rule_based, "--run", "5", *save): "No run has the seed 5; they have 666 to 668",
        (runs.rule_based, runs.rule_based, *save): "is there twice",
        (runs.rule_based.with_name("rule_based.actions.mcap"), *save): "Give the result that it belongs to",
        (tmp_path / "none.json", *save): "There is no result file",
    }.items():
        assert glbench("view", *arguments) == 1
        assert words in capsys.readouterr().err
    assert not (tmp_path / "x.rrd").exists()


def test_a_live_evaluation_streams_its_first_run_and_earns_the_same(runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with stream_into(tmp_path / "live.rrd") as address:

        @contextlib.contextmanager
        def viewer() -> Iterator[str]:
            yield address

        monkeypatch.setattr(evaluate_command, "live_viewer", viewer)
        assert glbench("evaluate", "rule_based", "--task", runs.task_file, "--out", tmp_path, "--live") == 0
    result = load_result(tmp_path / "results" / "Short-v1" / "rule_based.json")
    assert result.results_digest == load_result(runs.rule_based).results_digest
    curves = read_recording(tmp_path / "live.rrd").curves
    assert curves["/money/reward/rule_based"].values[-1] == result.runs[0].metrics["reward"]


@pytest.mark.parametrize("option", [("--web",), ("--port", "19377")])
def test_the_page_is_announced_with_an_address_of_this_machine(
    option: tuple[str, ...], runs: Runs, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("glbench.cli.view._wait", lambda: None)  # as if Ctrl-C had been pressed at once
    assert glbench("view", runs.rule_based, *option) == 0
    assert f"Open http://127.0.0.1:{option[-1] if len(option) > 1 else ''}" in capsys.readouterr().err.replace("\n", "")
